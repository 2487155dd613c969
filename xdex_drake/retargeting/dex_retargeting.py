"""Writes what dex-retargeting 0.5 needs to follow a person with a hand: a URDF file and a configuration an objective.

That tool compares vectors in the frame of the URDF's root, so that the root here is the wrist frame H: +z to the
fingers, +x out of the palm.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.human import MEAN_SHAPE, human_hand
from xdex_drake.interchange.parts import marked_frames
from xdex_drake.interchange.urdf import export_urdf
from xdex_drake.retargeting.hand_retargeter import hand_lengths
from xdex_drake.retargeting.keypoints import FINGERS, TIPS
from xdex_drake.whole_file import write_text

LOW_PASS = 0.2
"""Weight of the newest value in the tool's filter, as its own files have it for streams."""


def export_dex_retargeting(hand: Hand, folder: str | Path) -> list[Path]:
    """Writes NAME.urdf with meshes, and NAME_position.yml, NAME_vector.yml and NAME_dexpilot.yml.

    Fingers correspond by their names; those of no person are left out. Coupled joints are left to the URDF. The scale
    is the hand's size over a mean person's, measured along the fingers. Before loading one, tell the tool the folder:
    `RetargetingConfig.set_default_urdf_dir(folder)`.

    Args:
        hand: The hand.
        folder: The folder; made where it does not exist.

    Returns:
        The configurations; dexpilot's only where there is a thumb and another finger.

    Raises:
        ConfigError: No finger is named as a person's, or a file cannot be written.
        HandFileError: The URDF file cannot be written.
    """
    frames = {name.removesuffix("_frame").removesuffix("_tip"): name for name, *_ in marked_frames(hand)}
    fingers = [name for name in FINGERS if name in frames]
    if not fingers:
        raise ConfigError(f"hand {hand.name}: none of its fingers is named as a person's; name them in its file")
    folder = Path(folder)
    urdf = export_urdf(hand, folder, wrist_root=True)
    tips, indices, wrist = [frames[name] for name in fingers], [TIPS[name] for name in fingers], frames["wrist"]
    ours, theirs = hand_lengths(hand), hand_lengths(human_hand(MEAN_SHAPE))
    scale = round(float(np.mean([ours[name] / theirs[name] for name in fingers])), 3)
    shared = {"urdf_path": urdf.name, "target_joint_names": list(hand.joint_names), "low_pass_alpha": LOW_PASS}
    configurations: dict[str, dict[str, Any]] = {
        "position": {"target_link_names": tips, "target_link_human_indices": indices},
        "vector": {
            "target_origin_link_names": [wrist] * len(tips),
            "target_task_link_names": tips,
            "target_link_human_indices": [[0] * len(tips), indices],
            "scaling_factor": scale,
        },
    }
    if fingers[0] == "thumb" and len(fingers) > 1:
        links = {"wrist_link_name": wrist, "finger_tip_link_names": tips, "scaling_factor": scale}
        configurations["dexpilot"] = links if tuple(fingers) == FINGERS[: len(fingers)] else links | _pairs(indices)
    files = []
    for objective, content in configurations.items():
        file = folder / f"{urdf.stem}_{objective}.yml"
        write_text(file, yaml.safe_dump({"retargeting": {"type": objective, **shared, **content}}, sort_keys=False))
        files.append(file)
    return files


def _pairs(indices: list[int]) -> dict[str, Any]:
    """Dexpilot's vectors by a person's points, where the fingers are not a person's first ones, as the tool assumes."""
    n = len(indices)
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n)]
    origins = [indices[j] for _, j in pairs] + [0] * n
    return {"target_link_human_indices": [origins, [indices[i] for i, _ in pairs] + indices]}
