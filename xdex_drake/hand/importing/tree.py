"""Checks that all readers share: the links form one tree, and mimic laws lead to a joint that moves."""

from collections.abc import Callable

from xdex_drake.errors import HandFileError
from xdex_drake.hand.importing.model import FileJoint, FileLink


def as_one_tree(
    source: str, links: tuple[FileLink, ...], joints: tuple[FileJoint, ...], notes: list[str]
) -> tuple[tuple[FileLink, ...], tuple[FileJoint, ...]]:
    """Checks that the links form one tree; single links beside it are left out with a note.

    Args:
        source: File, for messages.
        links: All links.
        joints: All joints, between links that exist.
        notes: Receives what was left out.

    Returns:
        The links and joints of the tree, in the order of the file.

    Raises:
        HandFileError: A link has two parents, the links form a circle, or there are several trees.
    """
    parent: dict[str, str] = {}
    for joint in joints:
        if joint.child in parent:
            raise HandFileError(
                f"{source}: link {joint.child!r} is the child of several joints (one is {joint.name!r}); only trees "
                "can be imported: cut each loop open"
            )
        parent[joint.child] = joint.parent
    refuse_cycles(
        parent, lambda name: f"{source}: the links form a circle through {name!r}; every link needs a way to one base"
    )
    jointed = {joint.parent for joint in joints} | set(parent)
    alone = [link.name for link in links if link.name not in jointed]
    if jointed and alone:
        notes.append(f"links without any joint are left out: {', '.join(alone[:10])}")
        links = tuple(link for link in links if link.name in jointed)
    roots = [link.name for link in links if link.name not in parent]
    if len(roots) != 1:
        raise HandFileError(
            f"{source}: has {len(roots)} base links ({', '.join(roots[:5])}); join them, or give a file of one hand"
        )
    return links, joints


def check_mimics(joints: tuple[FileJoint, ...], source: str) -> None:
    """Checks that each mimic law leads, possibly over others, to a joint that moves on its own.

    Args:
        joints: All joints.
        source: File, for messages.

    Raises:
        HandFileError: A law names no joint, a fixed one, or leads in a circle.
    """
    moving = {joint.name for joint in joints if joint.kind != "fixed"}
    laws = {joint.name: joint.mimic.master for joint in joints if joint.mimic is not None}
    for name, master in laws.items():
        if master not in moving:
            raise HandFileError(
                f"{source}: joint {name!r} mimics {master!r}, which is no moving joint; name one, or remove the <mimic>"
            )
    refuse_cycles(
        laws, lambda name: f"{source}: the mimic laws lead in a circle through joint {name!r}; let one joint be free"
    )


def refuse_cycles(edges: dict[str, str], message: Callable[[str], str]) -> None:
    """Refuses a map from each name to the one before it that leads in a circle.

    Args:
        edges: The name before each name.
        message: The error's message for a name in a circle.

    Raises:
        HandFileError: There is a circle.
    """
    clear: set[str] = set()
    for first in edges:
        name, path = first, dict[str, None]()
        while name in edges and name not in clear:
            if name in path:
                raise HandFileError(message(name))
            path[name] = None
            name = edges[name]
        clear.update(path)
