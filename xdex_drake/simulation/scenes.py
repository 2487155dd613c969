"""The scene of a lift for MuJoCo: hand, object and table with the protocol's gains and the grasp's key frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.interchange.mjcf import MJCF, KeyFrame, MjcfSettings, ModelFile, scene_mjcf
from xdex_drake.interchange.parts import file_name
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LiftProtocol, protocol_scene, usual_protocol
from xdex_drake.simulation.trajectory import targets


def lift_scene(
    hand: Hand,
    scene: Scene,
    *,
    protocol: LiftProtocol | None = None,
    grasp: Grasp | None = None,
    settings: MjcfSettings = MJCF,
) -> ModelFile:
    """The scene of a lift as MJCF; see `interchange.mjcf.scene_mjcf`.

    Args:
        hand: The hand.
        scene: The object on its table.
        protocol: The protocol whose gains, mass and friction hold; that of `usual_protocol` where None.
        grasp: A grasp with pre-grasp and squeeze: where the wrist stands, and the key frames `pregrasp`, `grasp` and
            `squeeze`; the last one is the grasp with the squeeze's targets.
        settings: MuJoCo's physics.

    Returns:
        The model.
    """
    protocol = protocol or usual_protocol(scene)
    scene = protocol_scene(scene, protocol)
    if grasp is None:
        return scene_mjcf(hand, scene, plant=protocol.plant, settings=settings)
    return scene_mjcf(
        hand,
        replace(scene, X_WO=grasp.X_WO),
        plant=protocol.plant,
        X_WH=grasp.X_WH,
        keyframes=key_frames(grasp, protocol),
        name=grasp.grasp_id,
        settings=settings,
    )


def key_frames(grasp: Grasp, protocol: LiftProtocol) -> tuple[KeyFrame, ...]:
    """The begin of a lift and the ends of closing and squeezing; the squeeze's posture is the grasp's."""
    closed, ended = protocol.close_s, protocol.close_s + protocol.squeeze_s
    frames = []
    for name, t, t_posture in (("pregrasp", 0.0, 0.0), ("grasp", closed, closed), ("squeeze", ended, closed)):
        q, offset = targets(grasp, protocol, t)
        frames.append(KeyFrame(name, targets(grasp, protocol, t_posture)[0], q, offset))
    return tuple(frames)


def export_scenes(
    grasps: Iterable[tuple[Grasp, Hand, Scene]], folder: str | Path, *, protocol: LiftProtocol | None = None
) -> list[Path]:
    """Writes a scene for each grasp into a folder; see `lift_scene`.

    Args:
        grasps: Grasps with pre-grasp and squeeze, each with its hand and scene.
        folder: The folder; made where it does not exist. Scenes share the meshes in its `meshes`.
        protocol: The protocol whose gains, mass and friction hold; that of `usual_protocol` where None.

    Returns:
        Paths of the MJCF files, in the order of the grasps.

    Raises:
        ConfigError: A grasp has no pre-grasp or no squeeze, two have the same identifier, or the folder cannot be
            written.
    """
    files: dict[Path, None] = {}
    for grasp, hand, scene in grasps:
        name = grasp.grasp_id or f"{hand.name}-{scene.object.name}"
        if grasp.q_pregrasp is None or grasp.X_WH_pregrasp is None or grasp.tau_squeeze is None:
            raise ConfigError(f"grasp {name}: it has no pre-grasp or squeeze; make it with `xdex grasp`")
        file = Path(folder) / f"{file_name(name)}.xml"
        if file in files:
            raise ConfigError(f"grasp {name}: another grasp has this identifier; export them to folders of their own")
        files[lift_scene(hand, scene, protocol=protocol, grasp=grasp).write(file)] = None
    return list(files)
