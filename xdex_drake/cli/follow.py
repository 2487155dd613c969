"""`xdex follow`: a hand follows a person's."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from xdex_drake.cli.hands import HandName
from xdex_drake.cli.output import check_output_file, facts
from xdex_drake.whole_file import whole_file, write_text

if TYPE_CHECKING:
    import numpy as np
    from pydrake.math import RigidTransform

    from xdex_drake.arrays import Array
    from xdex_drake.retargeting.hand_retargeter import Following, HandRetargeter
    from xdex_drake.retargeting.object_stream import Guarded
    from xdex_drake.scene.object import ObjectModel


@dataclass(frozen=True)
class Follow:
    """A hand follows a person's: key points of a camera or a glove become joint values.

    POINTS is a .npy file of plain numbers, shape (T, 21, 3): wrist, then four points a finger from the palm to the tip,
    thumb first, as MediaPipe and MANO's usual order have them; in metres, in any frame. The wrist frame is seen from
    the points. The .npz file that is written holds `joint_names` and `q` (T, n) of the actuated joints,
    `all_joint_names` and `q_full` with the coupled ones, `X_WH` (T, 4, 4), `cost` and `error`; each frame starts from
    the one before.

    With --object and --at the hand stays out of that object, gives way with its wrist where it must, and no joint moves
    faster than 0.19 rad a frame; the object goes along once thumb and another finger touch. `X_WO` (T, 4, 4) and
    `clearance` [m] are written then, too.

    Try `xdex follow allegro points.npy --html follow.html`.

    Attributes:
        hand: A library name, a generated hand such as g0-0137, or the path of a .yaml, .urdf, .xml or .sdf file.
        points: The person's key points, a .npy file.
        out: Where to write the joint values, a .npz file.
        html: Write a page that plays the motion.
        objective: What is compared: fingertips by coordinate, vectors from the wrist to them, or with pinches.
        side: The person's hand; the hand's own side where not given. The other side is mirrored.
        scale: Size of the hand over that of the person's; measured from the points where not given.
        middles: The middle joints of the fingers follow, too; for position and vector.
        smoothing: Weight of squared joint increments [1/rad^2]; 0.004 calms a camera's noise.
        rate: Frames a second, for the page.
        object: A library name or the path of a mesh that the hand shall not go through.
        at: Its place in the points' frame: x y z [m], or x y z qw qx qy qz.
        object_scale: Factor from the mesh file's unit to metres; guessed where not given.
    """

    hand: tyro.conf.Positional[HandName]
    points: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="POINTS")]]
    out: Path = Path("joints.npz")
    html: Path | None = None
    objective: Literal["position", "vector", "dexpilot"] = "vector"
    side: Literal["right", "left"] | None = None
    scale: float | None = None
    middles: tyro.conf.FlagCreatePairsOff[bool] = False
    smoothing: float = 0.0
    rate: float = 30.0
    object: str | None = None
    at: tuple[float, ...] = ()
    object_scale: float | None = None

    def run(self) -> int:
        """Writes the joint values, and the page where asked for."""
        check_output_file(self.out, ".npz")
        if self.html is not None:
            check_output_file(self.html, ".html")
        import numpy as np

        from xdex_drake.errors import ConfigError
        from xdex_drake.hand.library import load_hand
        from xdex_drake.retargeting.hand_retargeter import HandRetargeter
        from xdex_drake.retargeting.keypoints import read_points
        from xdex_drake.retargeting.object_stream import follow_beside

        if not 1.0 <= self.rate <= 1000.0:
            raise ConfigError(f"--rate {self.rate}: give 1 to 1000 frames a second")
        points = read_points(self.points)
        hand = load_hand(self.hand)
        retargeter = HandRetargeter(
            hand,
            self.objective,
            side=self.side,
            scale=1.0 if self.scale is None else self.scale,
            middles=self.middles,
            smoothing=self.smoothing,
        )
        if self.scale is None:
            retargeter = retargeter.calibrated(points)
        beside = None if self.object is None else self._placed_object()
        if beside is None and self.at:
            raise ConfigError("--at places an object; name it by --object")
        start = time.process_time()
        guarded = [] if beside is None else list(follow_beside(retargeter, points, *beside))
        found = [_given_way(item) for item in guarded] if guarded else list(retargeter.follow(points))
        seconds = time.process_time() - start
        q = np.array([item.q for item in found])
        told = _told(retargeter, found, q, seconds) + _told_beside(guarded)
        print(facts([("hand", f"{hand.name} ({hand.display_name}), {hand.side}"), *told]))
        _write_joints(self.out, retargeter, found, q, guarded)
        print(f"joint values: {self.out}")
        if self.html is not None:
            from xdex_drake.visualization.motion import motion_page

            R_WH, p_WH = np.array([item.R_WH for item in found]), np.array([item.p_WH for item in found])
            shown = retargeter.scaled_points(points)
            rows = [(name, str(value)) for name, value in told]
            page = motion_page(hand, q, R_WH, p_WH, points=shown, frames_per_second=self.rate, rows=rows)
            write_text(self.html, page)
            print(f"page: {self.html}")
        return 0

    def _placed_object(self) -> tuple[ObjectModel, RigidTransform]:
        """The object and its pose."""
        import numpy as np
        from pydrake.common.eigen_geometry import Quaternion
        from pydrake.math import RigidTransform, RotationMatrix

        from xdex_drake.errors import ConfigError
        from xdex_drake.scene.object import load_object

        values = np.array(self.at, dtype=float)
        norm = float(np.linalg.norm(values[3:])) if len(values) == 7 else 1.0
        if len(values) not in (3, 7) or not np.isfinite(values).all() or norm < 1e-6:
            raise ConfigError("--at: give x y z in metres, or x y z qw qx qy qz, in the frame of the points")
        R = RotationMatrix(Quaternion(values[3:] / norm)) if len(values) == 7 else RotationMatrix()
        return load_object(str(self.object), scale=self.object_scale), RigidTransform(R, values[:3])


def _given_way(item: Guarded) -> Following:
    """A frame beside an object, for what tells of frames; its error is that of what was wanted."""
    R_WH, p_WH = item.X_WH.rotation().matrix(), item.X_WH.translation()
    return replace(item.wanted, q=item.q, R_WH=R_WH, p_WH=p_WH)


def _told_beside(guarded: list[Guarded]) -> list[tuple[str, object]]:
    import numpy as np

    if not guarded:
        return []
    least = 1e3 * min(item.clearance for item in guarded)
    shift = 1e3 * max(float(np.linalg.norm(item.X_WH.translation() - item.wanted.p_WH)) for item in guarded)
    touching = sum(bool(item.touching) for item in guarded)
    return [
        ("nearest link", f"{least:.2f} mm from the object (negative is inside)"),
        ("wrist gave way", f"by {shift:.1f} mm at most"),
        ("frames in contact", touching),
    ]


def _told(retargeter: HandRetargeter, found: list[Following], q: Array, seconds: float) -> list[tuple[str, object]]:
    import numpy as np

    errors = 1000.0 * np.array([item.error for item in found])
    jump = float(np.abs(np.diff(q, axis=0)).max(initial=0.0))
    left_out = ", ".join(retargeter.missing) or "none"
    return [
        ("frames", len(found)),
        ("objective", retargeter.objective),
        ("scale", f"{retargeter.scale:.3f}"),
        ("fingers left out", left_out + (f"; not moved: {', '.join(retargeter.unused)}" if retargeter.unused else "")),
        ("mean distance", f"{errors.mean():.1f} mm, at most {errors.max():.1f} mm"),
        ("greatest step", f"{jump:.3f} rad a frame"),
        ("processor time", f"{1000.0 * seconds / len(found):.2f} ms a frame"),
    ]


def _write_joints(
    path: Path, retargeter: HandRetargeter, found: list[Following], q: np.ndarray, guarded: list[Guarded]
) -> None:
    import numpy as np

    hand = retargeter.hand
    X_WH = np.tile(np.eye(4), (len(found), 1, 1))
    X_WH[:, :3, :3], X_WH[:, :3, 3] = [item.R_WH for item in found], [item.p_WH for item in found]
    beside = {}
    if guarded:
        beside["X_WO"] = np.array([item.X_WO.GetAsMatrix4() for item in guarded])
        beside["clearance"] = np.array([item.clearance for item in guarded])
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part, part.open("wb") as file:
        np.savez(
            file,
            hand=np.array(hand.name),
            objective=np.array(retargeter.objective),
            side=np.array(retargeter.side),
            scale=np.array(retargeter.scale),
            joint_names=np.array(hand.joint_names),
            q=q,
            all_joint_names=np.array([joint.name for joint in hand.joints]),
            q_full=hand.q_full(q),
            X_WH=X_WH,
            cost=np.array([item.cost for item in found]),
            error=np.array([item.error for item in found]),
            **beside,
        )
