"""From another tool's joints and frames to a hand's, by name, and back.

A file's gripper frame is a link of the hand, or lies at a fixed pose in one, and its joint values belong to names.
Where a file names neither, a few conventions of published sets are known; anything else has to be told by whoever has
the file: a guess would give another grasp, not an error.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.contact.certificate import certified_map
from xdex_drake.contact.cones import cone_edges
from xdex_drake.errors import ConfigError, GraspFileError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.interchange.dexgraspdb import polytope_volume
from xdex_drake.interchange.records import GraspRecord, Stage, Touching
from xdex_drake.scene.tabletop import Scene

WRIST = "wrist"
"""Name of the wrist frame H, where no link has it."""

ORDERS = ("actuated", "all")
"""Joint orders by a word: the hand's actuated joints, or all its joints, as `xdex hand show` lists them."""


@dataclass(frozen=True, eq=False)
class FrameChoice:
    """Where the gripper frame G of a file is on a hand.

    Attributes:
        link: A link of the hand, or `wrist`.
        X_LG: Pose of G in that link's frame.
    """

    link: str
    X_LG: RigidTransform


@dataclass(frozen=True, eq=False)
class Convention:
    """What a published set leaves unsaid, for a hand of the library.

    Attributes:
        frame: The gripper frame.
        joint_names: Joints in the order of the values.
        source: Where this is known from.
    """

    frame: FrameChoice
    joint_names: tuple[str, ...]
    source: str


def _turned(wxyz: Sequence[float]) -> RigidTransform:
    return RigidTransform(RotationMatrix(Quaternion(np.array(wxyz) / np.linalg.norm(wxyz))), np.zeros(3))


CONVENTIONS = {
    ("dexgraspbench", "shadow"): Convention(
        FrameChoice("palm", RigidTransform(np.array([0.0, 0.0, -0.034]))),
        tuple(
            f"{finger}J{k}"
            for finger, n in (("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5), ("TH", 5))
            for k in range(n, 0, -1)
        ),
        "the hand's MJCF there: world frame, 34 mm below the palm",
    ),
    ("dexgraspbench", "allegro"): Convention(
        FrameChoice("base_link", _turned([0.0, 1.0, 0.0, 1.0]).inverse()),
        tuple(f"joint_{k}.0" for k in range(16)),
        "the hand's MJCF there: world frame, in which the palm is turned by (0, 1, 0, 1)/sqrt 2",
    ),
}
"""By format and hand of the library."""


@dataclass(frozen=True, eq=False)
class HandStage:
    """A stage of a grasp as this library has it.

    Attributes:
        X_OH: Wrist pose in the object frame.
        q: Values of the actuated joints [rad or m], shape (n,).
        off_coupling: Greatest difference of a coupled joint's value in the file from its law [rad or m].
    """

    X_OH: RigidTransform
    q: Array
    off_coupling: float


@dataclass(frozen=True, eq=False)
class HandRecord:
    """A record, resolved for a hand.

    Attributes:
        record: The record.
        grasp: The hand while it touches.
        pregrasp: The open hand before, None where the file has none.
        squeeze: Targets of a squeeze by positions, None where the file has none.
        tau: Torques of the squeeze [N m or N], shape (n,), None where the file has none.
    """

    record: GraspRecord
    grasp: HandStage
    pregrasp: HandStage | None
    squeeze: HandStage | None
    tau: Array | None


def parse_frame(words: Sequence[str], hand: Hand) -> FrameChoice:
    """A gripper frame as a user tells it: a link, and perhaps a pose in it.

    Args:
        words: Name of a link, or `wrist`; then nothing, or x, y, z [m], or x, y, z, qw, qx, qy, qz.
        hand: The hand.

    Returns:
        The frame.

    Raises:
        ConfigError: There is no such link, or the rest is no pose.
    """
    link, *rest = words
    if link != WRIST and link not in hand.link_index:
        close = difflib.get_close_matches(link, [WRIST, *hand.link_index], n=1)
        mend = f"did you mean {close[0]}?" if close else f"use one of {', '.join([WRIST, *hand.link_index][:8])}"
        raise ConfigError(f"--frame {link}: {hand.name} has no such link; {mend}")
    try:
        numbers = np.array([float(word) for word in rest])
    except ValueError:
        numbers = np.full(1, np.nan)
    norm = float(np.linalg.norm(numbers[3:])) if len(numbers) == 7 else 1.0
    if len(numbers) not in (0, 3, 7) or not np.isfinite(numbers).all() or norm < 1e-6:
        raise ConfigError("--frame: after the link give nothing, x y z in metres, or x y z qw qx qy qz")
    if len(numbers) == 0:
        return FrameChoice(link, RigidTransform())
    R = RotationMatrix(Quaternion(numbers[3:] / norm)) if len(numbers) == 7 else RotationMatrix()
    return FrameChoice(link, RigidTransform(R, numbers[:3]))


def parse_order(words: Sequence[str], hand: Hand) -> tuple[str, ...]:
    """A joint order as a user tells it: names, or one of `ORDERS`."""
    if tuple(words) == ("actuated",):
        return hand.joint_names
    if tuple(words) == ("all",):
        return tuple(joint.name for joint in hand.joints)
    return tuple(words)


def convention_of(format: str, hand: Hand) -> Convention | None:
    """What is known of a format's files for a hand, where it is that of the library to the last number."""
    known = CONVENTIONS.get((format, hand.name))
    if known is None or hand.name not in list_hands() or hand_digest(hand) != hand_digest(load_hand(hand.name)):
        return None
    return known


def resolve(
    record: GraspRecord,
    hand: Hand,
    source: str,
    *,
    frame: FrameChoice | None = None,
    joint_order: Sequence[str] | None = None,
    convention: Convention | None = None,
) -> HandRecord:
    """A record with the joints and the wrist frame of a hand.

    What the user tells comes before what the file says, and that before a convention.

    Args:
        record: The record.
        hand: The hand.
        source: The file, for messages.
        frame: The gripper frame.
        joint_order: Names of the joints in the order of the values.
        convention: What is known of such files.

    Returns:
        The stages.

    Raises:
        GraspFileError: The file is of another hand, or does not tell what its numbers mean and nobody else does.
    """
    where = f"{source}: grasp {record.name}"
    names = joint_order or record.joint_names or (convention.joint_names if convention is not None else None)
    if names is None:
        raise GraspFileError(
            f"{source}: its {len(record.grasp.values)} joint values have no names; give their order by --joint-order, "
            f"as names or as one of {', '.join(ORDERS)}"
        )
    if len(names) != len(record.grasp.values):
        raise GraspFileError(f"{where} has {len(record.grasp.values)} joint values for {len(names)} joints")
    rows = joint_rows(hand, names, where)
    choice = frame or _frame_in_file(record, hand) or (convention.frame if convention is not None else None)
    if choice is None:
        told = f"its gripper frame {record.frame!r} is no link of {hand.name}" if record.frame else "it names no frame"
        raise GraspFileError(f"{source}: {told}; say which link its poses are of by --frame LINK, or --frame {WRIST}")
    stages = {
        name: None if stage is None else _hand_stage(stage, hand, rows, choice)
        for name, stage in (("grasp", record.grasp), ("pregrasp", record.pregrasp), ("squeeze", record.squeeze))
    }
    assert stages["grasp"] is not None
    tau = None if record.torques is None else record.torques[rows[_actuated(hand)]]
    return HandRecord(record, stages["grasp"], stages["pregrasp"], stages["squeeze"], tau)


def joint_rows(hand: Hand, names: Sequence[str], where: str) -> np.ndarray:
    """Where each joint of a hand stands among a file's joints, -1 for coupled ones that it leaves out.

    Names of the file may have a prefix in common that the hand's lack, such as `rh_` or `robot0:`.

    Args:
        hand: The hand.
        names: The file's joints.
        where: File and grasp, for the message.

    Returns:
        Places, in the order of `hand.joints`, shape (n_joints,).

    Raises:
        GraspFileError: An actuated joint is missing, or a joint of the file is none of the hand's.
    """
    ours = [joint.name for joint in hand.joints]
    short = list(names)
    if not set(names) & set(ours):
        for prefix in {name.removesuffix(own) for name in names for own in ours if name.endswith(own)}:
            cut = [name.removeprefix(prefix) for name in names]
            if all(name.startswith(prefix) for name in names) and set(hand.joint_names) <= set(cut):
                short = cut
    place = {name: k for k, name in enumerate(short)}
    missing = [name for name in hand.joint_names if name not in place]
    strange = [name for name in names if name not in ours] if short == list(names) else []
    if missing or strange:
        what = f"lacks joint {missing[0]!r} of {hand.name}" if missing else f"has {strange[0]!r}"
        raise GraspFileError(
            f"{where}: {what}, its joints are {', '.join(names[:4])}, ...: it is of another hand, or --joint-order is "
            "needed"
        )
    return np.array([place.get(name, -1) for name in ours])


def _actuated(hand: Hand) -> np.ndarray:
    return np.array([k for k, joint in enumerate(hand.joints) if joint.coupling is None])


def _frame_in_file(record: GraspRecord, hand: Hand) -> FrameChoice | None:
    known = record.frame == WRIST or record.frame in hand.link_index
    return FrameChoice(record.frame, RigidTransform()) if known else None


def _hand_stage(stage: Stage, hand: Hand, rows: np.ndarray, choice: FrameChoice) -> HandStage:
    q = stage.values[rows[_actuated(hand)]]
    told = rows >= 0
    off = np.abs(stage.values[rows[told]] - hand.q_full(q)[told]).max(initial=0.0)
    X_HG = choice.X_LG
    if choice.link in hand.link_index:
        R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), q)
        k = hand.link_index[choice.link]
        X_HG = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R_HLs[k]), p_HLs[k]) @ X_HG
    return HandStage(stage.X_OG @ X_HG.inverse(), q, float(off))


def record_of(grasp: Grasp, hand: Hand, scene: Scene, *, all_joints: bool = False) -> GraspRecord:
    """A grasp as files of other tools have it: poses of the base link in the object's frame.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.
        all_joints: Whether coupled joints are listed, too, as simulators have them.

    Returns:
        The record.
    """
    actuated = _actuated(hand)
    names = tuple(joint.name for joint in hand.joints) if all_joints else hand.joint_names
    X_OW, X_HB = grasp.X_WO.inverse(), RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB)

    def stage(X_WH: RigidTransform | None, q: Array | None) -> Stage | None:
        if X_WH is None or q is None:
            return None
        return Stage(X_OW @ X_WH @ X_HB, hand.q_full(q) if all_joints else q)

    tau = grasp.tau_squeeze
    if tau is not None and all_joints:
        full = np.zeros(len(hand.joints))
        full[actuated] = tau
        tau = full
    model = scene.object
    at_grasp = stage(grasp.X_WH, grasp.q)
    assert at_grasp is not None
    return GraspRecord(
        name=grasp.grasp_id,
        grasp=at_grasp,
        pregrasp=stage(grasp.X_WH_pregrasp, grasp.q_pregrasp),
        squeeze=stage(grasp.X_WH, grasp.q_squeeze),
        torques=tau,
        joint_names=names,
        frame=hand.links[0].name,
        hand=hand.name,
        object=model.name if model.path is None else model.path.name,
        scale=model.scale,
        X_WO=grasp.X_WO,
        contacts=_touching(grasp, hand),
        scores=_scores(grasp),
    )


def _touching(grasp: Grasp, hand: Hand) -> tuple[Touching, ...]:
    if grasp.certificate is None:
        return ()
    finger_of = {link: finger.name for finger in hand.fingers for link in finger.links}
    return tuple(Touching(finger_of.get(c.link, ""), c.p_OC, c.n_OC) for c in grasp.certificate.contacts)


def _scores(grasp: Grasp) -> dict[str, float]:
    """What formats ask for: whether it is good, and two classical qualities."""
    scores = {"confidence": 1.0 if grasp.lift is None else float(grasp.lift.success)}
    proof = grasp.certificate
    if proof is None:
        return scores
    grasp_map = certified_map(proof)
    edges = cone_edges(grasp_map.mus, 4)  # (n, 3, 4)
    columns = grasp_map.scaled.reshape(6, -1, 3).transpose(1, 0, 2) @ edges  # (n, 6, 4)
    volume = polytope_volume(np.swapaxes(columns, 1, 2).reshape(-1, 6))
    return {**scores, "epsilon_quality": proof.margin_lower, "volume_quality": volume}
