"""What the writers of all formats share: numbers, file names, marked frames, convex hulls as OBJ files, and writing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand


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
    normals = hull.equations[:, :3]
    a, b, c = vertices[hull.simplices].transpose(1, 0, 2)
    inward = np.einsum("nk,nk->n", np.cross(b - a, c - a), normals) <= 0.0
    corners = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    index = np.zeros(len(vertices), dtype=int)
    index[hull.vertices] = np.arange(1, len(hull.vertices) + 1)
    lines = [f"v {numbers(p)}" for p in vertices[hull.vertices]]
    lines += [f"vn {numbers(n)}" for n in normals]
    lines += [f"f {i}//{k} {j}//{k} {m}//{k}" for k, (i, j, m) in enumerate(index[corners].tolist(), start=1)]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class ModelFile:
    """A hand, an object or a scene in some format.

    Attributes:
        xml: The main file's text.
        meshes: Files of the folder `meshes` beside it, by name.
    """

    xml: str
    meshes: Mapping[str, str] = field(repr=False)

    def write(self, file: str | Path) -> Path:
        """Writes the file and its meshes.

        Args:
            file: The main file; folders are made where they do not exist.

        Returns:
            The file.

        Raises:
            ConfigError: It cannot be written.
        """
        file = Path(file)
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            if self.meshes:
                (file.parent / "meshes").mkdir(exist_ok=True)
            for name, text in self.meshes.items():
                (file.parent / "meshes" / name).write_text(text, encoding="ascii")
            file.write_text(self.xml, encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{file}: cannot be written ({error.strerror}); choose another folder") from None
        return file
