"""The moving picture at the top of the README: one can, lifted by six hands at once, with the forces.

    python studies/picture/six_hands.py --out docs/six_hands.webp

Six grasps are synthesised, certified and lifted by the library's own programs (seed 0), filmed in simulation, and
rendered without a window. The still beside it (`six_hands.jpg`) is the last moment.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image as PillowImage
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.grasping.synthesis import synthesize
from xdex_drake.hand.description import Hand
from xdex_drake.hand.human import human_hand
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import Scene, make_scene, pose_of
from xdex_drake.visualization.film import FRAMES_PER_SECOND, Film, film_lift
from xdex_drake.visualization.moving_picture import render_films
from xdex_drake.visualization.pictures import FOV_Y
from xdex_drake.visualization.views import Blobs, best_direction, frame_blobs, grasp_blobs

SIZE = (1000, 360)
GAP = 0.36
"""Distance of neighbors [m]."""

EVERY = 2
"""Every second frame is shown."""

HOLD_FRAMES = 10
"""Pictures for which the end stands still."""

QUALITY = 62


def lifted(hand: Hand, scene: Scene, tries: int = 4) -> Film:
    """The recorded lift of the first grasp that lifts."""
    for seed in range(tries):
        for grasp in synthesize(hand, scene, count=1, seed=seed):
            film = film_lift(grasp, hand, scene)
            if film.lift.success:
                return film
    raise SystemExit(f"{hand.name}: no grasp lifted")


def turned(film: Film, azimuth: float) -> Film:
    """A lift turned about the vertical through its object, which changes nothing about it."""
    X = RigidTransform(RollPitchYaw(0.0, 0.0, azimuth), np.zeros(3))
    frames = tuple(
        replace(
            frame,
            X_WLs=tuple(X @ X_WL for X_WL in frame.X_WLs),
            X_WO=X @ frame.X_WO,
            pushes=tuple(replace(p, p_WC=X @ p.p_WC, f_W=X.rotation() @ p.f_W) for p in frame.pushes),
        )
        for frame in film.frames
    )
    return replace(film, frames=frames)


def main() -> None:
    """Makes the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/six_hands.webp"))
    out = parser.parse_args().out
    thing = load_object("can")
    scene = make_scene(thing, pose=pose_of(thing, upright=True))
    films, blobs = [], []
    for hand in [*(load_hand(name) for name in list_hands()), human_hand()]:
        film = lifted(hand, scene)
        print(f"{hand.name}: rises {100.0 * film.lift.lift_height_m:.1f} cm, {len(film.frames)} frames", flush=True)
        # Each is turned to its best side.
        direction = best_direction(film.grasp, hand, scene)
        azimuth = -np.pi / 2 - float(np.arctan2(direction[1], direction[0]))
        films.append(turned(film, azimuth))
        ball = grasp_blobs(film.grasp, hand, scene, rise_m=0.25)
        c, s = np.cos(azimuth), np.sin(azimuth)
        blobs.append(Blobs(ball.centers_W @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), ball.radii))
    offsets = np.asarray(GAP * np.column_stack([np.arange(6) - 2.5, np.zeros((6, 2))]), dtype=np.float64)
    everything = Blobs(
        np.concatenate([b.centers_W + offset for b, offset in zip(blobs, offsets, strict=True)]),
        np.concatenate([b.radii for b in blobs]),
    )
    X_WC = frame_blobs(everything, np.array([0.0, -1.0, 0.42]), fov_y=FOV_Y, aspect=SIZE[0] / SIZE[1], margin=1.02)
    last = max(len(film.frames) for film in films) - 1
    moments = [*range(0, last, EVERY), *([last] * HOLD_FRAMES)]
    distinct = sorted(set(moments))
    images = render_films(films, offsets, distinct, X_WC, size=SIZE)
    shown = dict(zip(distinct, images, strict=True))
    pictures = [PillowImage.fromarray(shown[m]) for m in moments]
    pictures[0].save(
        out,
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000.0 * EVERY / FRAMES_PER_SECOND),
        loop=0,
        quality=QUALITY,
        method=6,
    )
    pictures[-1].save(out.with_suffix(".jpg"), quality=88)
    print(f"{out}: {len(pictures)} pictures, {out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
