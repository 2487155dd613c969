"""Masses, moments of inertia and efforts to simulate a hand with: the file's, where they make sense."""

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Geometry, Hand
from xdex_drake.hand.importing.bodies import Member, link_poses
from xdex_drake.hand.importing.decisions import Decision, Decisions, join
from xdex_drake.hand.importing.model import FileInertia
from xdex_drake.hand.inertia import ROTOR_INERTIA, link_inertia

MOST_MASS = 5.0
"""No link of a hand is heavier [kg]."""

TIP_FORCE = 10.0
"""Lasting force that a fingertip can press with, where the file does not say [N]."""

MOST_TIP_FORCE = 60.0
"""An effort that would press a fingertip harder than this is a placeholder [N]; data sheets give 5 to 35 N."""

GRIP_FORCE = 40.0
"""Force of a sliding jaw, where the file does not say [N]."""

MOST_GRIP_FORCE = 500.0
"""An effort of a sliding jaw above this is a placeholder [N]."""

LEAST_LEVER = 0.05
"""Shortest lever that an effort is judged by [m]; the last joints of a finger often share a motor with longer ones."""


def body_inertias(
    names: list[str],
    members: tuple[tuple[Member, ...], ...],
    geometry: list[tuple[Geometry, ...]],
    decisions: Decisions,
) -> list[tuple[float, Array, Array]]:
    """Mass, center of mass and moments of each body.

    Args:
        names: Names of the bodies.
        members: The links of the file that make them up.
        geometry: Their shapes in L.
        decisions: Grows by what was decided.

    Returns:
        For each body its mass [kg], p_LLcm [m] and I_LLcm [kg m^2], physically valid, with the inertia of a geared
        rotor added as for every hand of the library.
    """
    out = []
    missing, no_mass, bad = [], [], []
    for name, body, shapes in zip(names, members, geometry, strict=True):
        given = [(_inertia_in_L(m.link.inertia, m.X_LF), m.link.name) for m in body if m.link.inertia is not None]
        sound = [inertia for inertia, _ in given if _has_mass(inertia)]
        no_mass.extend(link for inertia, link in given if not _has_mass(inertia))
        if not sound:
            if not given:
                missing.append(name)
            out.append(link_inertia(shapes))
            continue
        whole = _sum(sound)
        if not _valid(whole, shapes):
            bad.append(name)
            out.append(link_inertia(shapes, min(whole.mass, MOST_MASS)))
            continue
        out.append((whole.mass, whole.p_LLcm, whole.I_LLcm + ROTOR_INERTIA * np.eye(3)))
    for links, text in (
        (missing, "no inertia in the file; mass and moments are those of its shape at 1100 kg/m3."),
        (no_mass, "a mass in the file that is not positive; it was left out."),
        (bad, "moments of inertia that no body of its shape can have; they were computed from its shape and its mass."),
    ):
        if links:
            decisions.append(Decision("mended", f"link {join(links)}", text))
    text = f"the inertia of geared rotors, {ROTOR_INERTIA:g} kg m2, is added to every link, as for the library's hands."
    decisions.append(Decision("decided", "hand", text))
    return out


def _inertia_in_L(inertia: FileInertia, X_LF: Array) -> FileInertia:
    R = X_LF[:3, :3]
    return FileInertia(float(inertia.mass), R @ inertia.p_LLcm + X_LF[:3, 3], R @ inertia.I_LLcm @ R.T)


def _has_mass(inertia: FileInertia) -> bool:
    return bool(np.isfinite(inertia.mass) and inertia.mass > 0.0 and np.isfinite(inertia.p_LLcm).all())


def _sum(parts: list[FileInertia]) -> FileInertia:
    mass = sum(part.mass for part in parts)
    center = sum((part.mass * part.p_LLcm for part in parts), np.zeros(3)) / mass
    moments = np.zeros((3, 3))
    for part in parts:
        d = part.p_LLcm - center
        moments += part.I_LLcm + part.mass * (float(d @ d) * np.eye(3) - np.outer(d, d))
    return FileInertia(mass, center, moments)


def _valid(inertia: FileInertia, shapes: tuple[Geometry, ...]) -> bool:
    I = inertia.I_LLcm  # noqa: E741
    if not np.isfinite(I).all() or inertia.mass > MOST_MASS or np.abs(I - I.T).max() > 1e-9 + 1e-6 * np.abs(I).max():
        return False
    a, b, c = np.linalg.eigvalsh(I)
    if a <= 0.0 or a + b < c * (1.0 - 1e-6):
        return False
    if not shapes:
        return True
    # A body whose mass lies on its outline has radii of gyration within that outline.
    corners = np.concatenate([shape.bounds() for shape in shapes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float(np.linalg.norm(high - low))
    off = np.maximum(np.maximum(low - inertia.p_LLcm, inertia.p_LLcm - high), 0.0)
    return bool(c <= inertia.mass * size**2 and np.linalg.norm(off) <= max(size, 0.02))


def joint_efforts(hand: Hand, tips: list[tuple[int, Array]], q: Array, decisions: Decisions) -> list[float]:
    """Effort of each joint: the file's where it is plausible, else by rule.

    The rule: 10 N at the fingertip of a turning joint, by the distance from its center to the farthest tip it moves;
    40 N for a sliding one.

    Args:
        hand: The tree, with the file's efforts (NaN where it gives none).
        tips: Last link and tip point of each finger.
        q: Posture at which levers are measured, fingers straight, shape (n,).
        decisions: Grows by what was decided.

    Returns:
        Efforts [N m or N] in the order of `joints`.
    """
    R, p = (x[0] for x in link_poses(hand, q))
    efforts, replaced = [], []
    for k, joint in enumerate(hand.joints):
        arms = [p[b] + R[b] @ tip - p[k + 1] for b, tip in tips if hand.ancestors[k, b]]
        lever = max((float(np.linalg.norm(arm)) for arm in arms), default=0.0)
        sliding = joint.kind == "prismatic"
        most = MOST_GRIP_FORCE if sliding else MOST_TIP_FORCE * max(lever, LEAST_LEVER)
        if np.isfinite(joint.effort) and 0.0 < joint.effort <= most:
            efforts.append(joint.effort)
            continue
        by_rule = GRIP_FORCE if sliding else TIP_FORCE * lever or 0.3
        efforts.append(float(f"{by_rule:.3g}"))
        if joint.coupling is None:
            given = "none" if not np.isfinite(joint.effort) else f"{joint.effort:g}"
            replaced.append(f"{joint.name} ({given} -> {efforts[-1]:g})")
    if replaced:
        text = f"{join(replaced, 24)}: an effort that is missing or would press a fingertip with more than "
        text += (
            f"{MOST_TIP_FORCE:.0f} N is a placeholder; it becomes {TIP_FORCE:.0f} N at the tip, for a sliding joint "
        )
        decisions.append(Decision("decided", "hand", text + f"{GRIP_FORCE:.0f} N."))
    return efforts
