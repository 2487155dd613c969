"""A motion of a hand in Meshcat, as a page that plays it: a hand that follows a person's, with the key points."""

from __future__ import annotations

import gc
from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Meshcat, MeshcatAnimation, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.visualization.page import ASPECT, FOV_Y, Legend, Trimmings, write_page
from xdex_drake.visualization.stage import (
    PAUSE_FRAMES,
    REPETITIONS,
    aim,
    draw_hand,
    draw_touch,
    link_labels,
    start_meshcat,
    touch_switch,
)
from xdex_drake.visualization.views import Blobs, frame_blobs

POINT_COLOR, POINT_RADIUS = (0.90, 0.35, 0.10, 1.0), 0.005
"""Color and radius [m] of a person's key points."""

MOST_FRAMES = 3000
"""A page of more frames than this grows too large for a browser."""


def motion_page(
    hand: Hand,
    qs: Array,
    R_WH: Array,
    p_WH: Array,
    *,
    points: Array | None = None,
    frames_per_second: float = 30.0,
    title: str = "",
    rows: Sequence[tuple[str, str]] = (),
) -> str:
    """A page that plays a motion again and again.

    Args:
        hand: The hand.
        qs: Its actuated joint values [rad or m], shape (T, n).
        R_WH: Rotations of its wrist frame, shape (T, 3, 3).
        p_WH: Origins of its wrist frame [m], shape (T, 3).
        points: Points that move with it, as a person's key points [m], shape (T, m, 3).
        frames_per_second: Frames a second.
        title: Title of the page; the hand's where empty.
        rows: Names and values for the card in the page's corner.

    Returns:
        HTML that needs no other file and no network.

    Raises:
        ConfigError: There is no frame, there are more than `MOST_FRAMES`, or Meshcat finds no free port.
    """
    if not 1 <= len(qs) <= MOST_FRAMES:
        raise ConfigError(f"a page plays 1 to {MOST_FRAMES} frames, not {len(qs)}; leave some out")
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), qs)
    R_WLs, p_WLs = R_WH[:, None] @ R_HLs, (R_WH[:, None] @ p_HLs[..., None])[..., 0] + p_WH[:, None]
    meshcat = start_meshcat(live=False)
    try:
        drawn = ("/drake/hand", hand, [str(k) for k in range(len(hand.links))])
        draw_hand(meshcat, *drawn)
        draw_touch(meshcat, *drawn)
        animation = MeshcatAnimation(frames_per_second)
        # The end stands still for a moment.
        moments = [*range(len(qs)), len(qs) - 1 + PAUSE_FRAMES]
        for moment in moments:
            t = min(moment, len(qs) - 1)
            for link in range(len(hand.links)):
                X_WL = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R_WLs[t, link]), p_WLs[t, link])
                animation.SetTransform(moment, f"/drake/hand/{link}", X_WL)
        if points is not None:
            _play_points(meshcat, animation, points, moments)
        animation.set_autoplay(True)
        animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
        animation.set_repetitions(REPETITIONS)
        meshcat.SetAnimation(animation)
        seen = _seen(hand, R_WLs, p_WLs)
        aim(meshcat, frame_blobs(seen, _direction(R_WH), fov_y=FOV_Y, aspect=ASPECT), seen.centers_W.mean(axis=0))
        legend = [] if points is None else [Legend("ball", POINT_COLOR, "key points of a person's hand")]
        trimmings = Trimmings(
            title or hand.display_name,
            rows=rows,
            legend=legend,
            names=link_labels(*drawn),
            switches=touch_switch([drawn]) | ({} if points is None else {"key points": ["/drake/points"]}),
        )
        page = write_page(meshcat, trimmings)
    finally:
        # Its port is to be free again now.
        del meshcat
        gc.collect()
    return page


def _play_points(meshcat: Meshcat, animation: MeshcatAnimation, points: Array, moments: Sequence[int]) -> None:
    for k in range(points.shape[1]):
        meshcat.SetObject(f"/drake/points/{k}", Sphere(POINT_RADIUS), Rgba(*POINT_COLOR))
        for moment in moments:
            animation.SetTransform(
                moment, f"/drake/points/{k}", RigidTransform(points[min(moment, len(points) - 1), k])
            )


def _seen(hand: Hand, R_WLs: Array, p_WLs: Array) -> Blobs:
    """The hand's spheres at some ten moments."""
    chosen = np.unique(np.linspace(0, len(R_WLs) - 1, 10).astype(int))
    links, spheres = hand.sphere_links, hand.spheres
    centers = (R_WLs[chosen][:, links] @ spheres[:, :3, None])[..., 0] + p_WLs[chosen][:, links]
    return Blobs(centers.reshape(-1, 3), np.tile(spheres[:, 3], len(chosen)))


def _direction(R_WH: Array) -> Array:
    """Toward a camera that sees palm and thumb, from above."""
    palm, thumb = R_WH[:, :, 0].mean(axis=0), R_WH[:, :, 1].mean(axis=0)
    direction = palm + 0.3 * thumb
    level = np.array([direction[0], direction[1], 0.0])
    length = np.linalg.norm(level)
    # A palm that faces up or down is seen from where the fingers point from.
    level = level / length if length > 0.2 else np.array([-1.0, 0.3, 0.0])
    return level + np.array([0.0, 0.0, 0.45])
