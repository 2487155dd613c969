"""What the writers of all formats share: numbers, file names, marked frames, convex hulls as OBJ files."""

import numpy as np
from scipy.spatial import ConvexHull

from xdex_drake.hand.description import Array, Hand


def numbers(values: Array) -> str:
    """Numbers as text that reads back as the same doubles, with blanks between them."""
    return " ".join(number(value) for value in np.asarray(values).tolist())


def number(value: float) -> str:
    """A number as text that reads back as the same double; no negative zero."""
    return repr(float(value) + 0.0)


def file_name(name: str) -> str:
    """A name with every letter replaced that a file's name should not have."""
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name)


def marked_frames(hand: Hand) -> list[tuple[str, str, Array, Array]]:
    """The frames that mark wrist and fingertips.

    Args:
        hand: The hand.

    Returns:
        Name (`wrist`, `FINGER_tip`; never that of a link), name of the link that carries it, position [m] and rotation
        in that link's frame.
    """
    taken = {link.name for link in hand.links}
    R_BH = hand.R_HB.T
    marks = [("wrist", hand.links[0].name, -R_BH @ hand.p_HB, R_BH)]
    marks += [(f"{f.name}_tip", f.tip_link, f.p_LTip, np.eye(3)) for f in hand.fingers]
    return [(name if name not in taken else f"{name}_frame", link, p, R) for name, link, p, R in marks]


def hull_obj(vertices: Array) -> str:
    """The convex hull of some points as an OBJ file, each triangle with its outward normal.

    Args:
        vertices: Points [m], shape (n, 3).

    Returns:
        The file's text.
    """
    hull = ConvexHull(vertices)
    index = {int(k): i + 1 for i, k in enumerate(hull.vertices)}
    lines = [f"v {numbers(vertices[k])}" for k in hull.vertices]
    normals = hull.equations[:, :3]
    lines += [f"vn {numbers(n)}" for n in normals]
    for k, corners in enumerate(hull.simplices):
        a, b, c = vertices[corners]
        ordered = corners if np.cross(b - a, c - a) @ normals[k] > 0.0 else corners[::-1]
        lines.append("f " + " ".join(f"{index[int(corner)]}//{k + 1}" for corner in ordered))
    return "\n".join(lines) + "\n"
