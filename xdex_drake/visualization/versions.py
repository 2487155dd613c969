"""One grasp by many hands, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xdex_drake.dataset.files import StoredGrasp
from xdex_drake.errors import ConfigError
from xdex_drake.visualization.pictures import FOV_Y, Image, contact_sheet, render_grasp
from xdex_drake.visualization.views import Blobs, best_direction, frame_blobs, grasp_blobs


def picture_of_versions(
    versions: Sequence[StoredGrasp], *, size: tuple[int, int] = (320, 320), columns: int = 6
) -> Image:
    """Pictures of one grasp and its versions by other hands, all from one side, as in Fig. 1 of the paper.

    Args:
        versions: The grasps, of one scene, the source first; at least one.
        size: Width and height of each picture [pixels].
        columns: Number of pictures in a row.

    Returns:
        One picture with the name of the hand under each.

    Raises:
        ConfigError: There is no grasp.
        MissingExtra: This machine cannot render.
    """
    if not versions:
        raise ConfigError("there is no grasp to show; give the source and its versions")
    first = versions[0]
    parts = [grasp_blobs(item.grasp, item.hand, item.scene) for item in versions]
    everything = Blobs(np.concatenate([p.centers_W for p in parts]), np.concatenate([p.radii for p in parts]))
    direction = best_direction(first.grasp, first.hand, first.scene)
    X_WC = frame_blobs(everything, direction, fov_y=FOV_Y, aspect=size[0] / size[1])
    images = [render_grasp(item.grasp, item.hand, item.scene, size=size, X_WC=X_WC) for item in versions]
    return contact_sheet(images, [item.hand.name for item in versions], columns)
