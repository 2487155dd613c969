"""Refuses robot files that do not describe a tree of links with finite numbers; each error names the field."""

import numpy as np

from xdex_drake.errors import HandFileError
from xdex_drake.hand.importing.model import FileJoint, FileModel

MAX_LINKS = 500
"""A hand has 30 links, a robot that carries two hands about 120."""

MAX_LENGTH = 10.0
"""No joint of a hand or an arm is farther from its parent than this [m]."""

KINDS = ("fixed", "revolute", "continuous", "prismatic")


def check_model(model: FileModel) -> None:
    """Checks that a model is a tree whose numbers can be used.

    Args:
        model: The robot as its file has it.

    Raises:
        HandFileError: It is not; the message names file, field and remedy.
    """
    if not model.links:
        raise _error(model, "the robot", "has no link", "give a file that describes a robot")
    if len(model.links) > MAX_LINKS:
        raise _error(
            model, "the robot", f"has {len(model.links)} links, more than {MAX_LINKS}", "cut the hand out of the scene"
        )
    _check_names(model)
    for joint in model.joints:
        _check_joint(model, joint)
    _check_tree(model)
    _check_mimics(model)
    if all(joint.kind == "fixed" for joint in model.joints):
        raise _error(model, "the robot", "has no movable joint", "give a hand whose fingers move")


def _error(model: FileModel, subject: str, what: str, mend: str) -> HandFileError:
    return HandFileError(f"{model.source}: {subject} {what}; {mend}")


def _check_names(model: FileModel) -> None:
    for kind, names in (("link", [k.name for k in model.links]), ("joint", [j.name for j in model.joints])):
        seen = set()
        for name in names:
            if not name:
                raise _error(model, f"a {kind}", "has no name", "name it")
            if name in seen:
                raise _error(model, f"{kind} {name!r}", "is described twice", "rename one of the two")
            seen.add(name)


def _check_joint(model: FileModel, joint: FileJoint) -> None:
    subject = f"joint {joint.name!r}"
    if joint.kind not in KINDS:
        raise _error(model, subject, f"is of type {joint.kind!r}", f"use one of {', '.join(KINDS)}")
    origin = np.concatenate([np.ravel(joint.p_PJ), np.ravel(joint.R_PJ)])
    if origin.shape != (12,) or not np.isfinite(origin).all():
        raise _error(model, f"{subject}: its origin", "is not finite", "give numbers for xyz and rpy")
    if np.abs(joint.p_PJ).max() > MAX_LENGTH:
        far = float(np.abs(joint.p_PJ).max())
        raise _error(model, f"{subject}: its origin", f"is {far:g} m from its parent", "write lengths in metres")
    if np.abs(joint.R_PJ @ joint.R_PJ.T - np.eye(3)).max() > 1e-6 or np.linalg.det(joint.R_PJ) < 0.0:
        raise _error(model, f"{subject}: its origin", "is no rotation", "give an orthonormal rotation")
    if joint.kind == "fixed":
        return
    length = float(np.linalg.norm(joint.axis))
    if not np.isfinite(length) or length < 1e-9:
        what = "is not finite" if not np.isfinite(length) else "is zero"
        raise _error(model, f"{subject}: its axis", what, "give the direction that it turns about or slides along")
    for name, limit in (("lower", joint.lower), ("upper", joint.upper)):
        if np.isnan(limit):
            raise _error(model, f"{subject}: its {name} limit", "is not a number", "give it in rad or m")
    if joint.mimic is not None and not np.isfinite([joint.mimic.multiplier, joint.mimic.offset]).all():
        raise _error(model, f"{subject}: its mimic law", "is not finite", "give numbers for multiplier and offset")


def _check_tree(model: FileModel) -> None:
    names = {link.name for link in model.links}
    parents: dict[str, str] = {}
    for joint in model.joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in names:
                raise _error(
                    model, f"joint {joint.name!r}: its {role} {link!r}", "is no link of the file", "name one that is"
                )
        if joint.child in parents:
            raise _error(model, f"link {joint.child!r}", "is the child of two joints", "remove one of them")
        parents[joint.child] = joint.parent
    for start in names:
        link, seen = start, set()
        while link in parents:
            if link in seen:
                raise _error(model, f"link {link!r}", "is its own ancestor", "break the cycle of joints")
            seen.add(link)
            link = parents[link]
    roots = [link.name for link in model.links if link.name not in parents]
    if len(roots) > 1:
        listed = ", ".join(repr(name) for name in roots[:4])
        raise _error(
            model, "the robot", f"has {len(roots)} links without a parent ({listed})", "join them by fixed joints"
        )


def _check_mimics(model: FileModel) -> None:
    by_name = {joint.name: joint for joint in model.joints}
    for joint in model.joints:
        seen = {joint.name}
        here = joint
        while here.mimic is not None:
            master = here.mimic.master
            subject = f"joint {here.name!r}: its mimic master {master!r}"
            if master not in by_name:
                raise _error(model, subject, "is no joint of the file", "name one that is")
            if master in seen:
                raise _error(model, subject, "follows the joint itself", "break the cycle of mimic laws")
            seen.add(master)
            here = by_name[master]
