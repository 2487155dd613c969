"""What a term of a grasp program reads and gives, the same for a batch of candidates and for one trial point.

A `View` holds what kinematics and distances give at a configuration: NumPy arrays at a `Point` of a program, torch
tensors for the batch of a search. A `Term` reads some of it and returns its value and its `Pull`, the gradient with
respect to what it has read. It knows no Jacobian: the view carries a pull back to wrist and joints, in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np

from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand


class View(Protocol):
    """What terms read. Leading dimensions `...` are (B,) in a search and absent at a point; all in SI units and in W.

    A contact here is a part of the hand that may touch (`contact_slots`), with its sphere that is nearest to the
    object; those that shall touch have 1 in `touching`.
    """

    @property
    def hand(self) -> Hand:
        """The hand."""
        ...

    @property
    def p_WOcm(self) -> Any:
        """The object's center of mass [m], shape (3,)."""
        ...

    @property
    def length(self) -> float:
        """Length that divides torques [m]."""
        ...

    @property
    def limits(self) -> Any:
        """Joint limits, rows (lower, upper) [rad or m], shape (2, n)."""
        ...

    @property
    def radii(self) -> Any:
        """Radii of the spheres that stand for the hand [m], shape (m,)."""
        ...

    @property
    def reach(self) -> Any:
        """Sum of the radii of each pair of spheres that must not overlap [m], shape (k,)."""
        ...

    @property
    def contact_radii(self) -> Any:
        """Radius of each contact's sphere [m], shape (..., nc)."""
        ...

    @property
    def touching(self) -> Any:
        """1 for contacts that are asked for and 0 for others, shape (..., nc)."""
        ...

    @property
    def forces_W(self) -> Any:
        """Forces on the object that leave little unbalanced wrench (`relaxed_forces`) [-], shape (..., nc, 3)."""
        ...

    @property
    def R_WH(self) -> Any:
        """Rotation of the wrist, shape (..., 3, 3)."""
        ...

    @property
    def p_WH(self) -> Any:
        """Origin of the wrist [m], shape (..., 3)."""
        ...

    @property
    def q(self) -> Any:
        """Actuated joint values [rad or m], shape (..., n)."""
        ...

    @property
    def R_WLs(self) -> Any:
        """Rotations of the links, shape (..., n_links, 3, 3)."""
        ...

    @property
    def p_WLs(self) -> Any:
        """Origins of the links [m], shape (..., n_links, 3)."""
        ...

    @property
    def palm_W(self) -> Any:
        """Unit vector along which the palm approaches (`approach_axis`), shape (..., 3)."""
        ...

    @property
    def tips_W(self) -> Any:
        """Tips of the fingers, in the order of `hand.fingers` [m], shape (..., n_fingers, 3)."""
        ...

    @property
    def centers_W(self) -> Any:
        """Centers of the spheres that stand for the hand [m], shape (..., m, 3)."""
        ...

    @property
    def distances(self) -> Any:
        """Signed distance of each center from the object [m], shape (..., m)."""
        ...

    @property
    def heights(self) -> Any:
        """Height of each center above the table, infinite where there is none [m], shape (..., m)."""
        ...

    @property
    def between_W(self) -> Any:
        """Difference of the centers of each pair of spheres that must not overlap [m], shape (..., k, 3)."""
        ...

    @property
    def contact_distances(self) -> Any:
        """Signed distance of the center of each contact's sphere from the object [m], shape (..., nc)."""
        ...

    @property
    def contacts_W(self) -> Any:
        """Contact points: the object's surface points nearest to the spheres [m], shape (..., nc, 3)."""
        ...

    @property
    def normals_W(self) -> Any:
        """Unit contact normals into the object, shape (..., nc, 3)."""
        ...

    @property
    def pads_W(self) -> Any:
        """Unit vectors out of the pads of the contacts' links, shape (..., nc, 3)."""
        ...


@dataclass(frozen=True)
class Pull:
    """Gradient of a value with respect to what a view offers: of the same names and shapes, None where it is zero.

    Rotations are pulled entry by entry: the gradient of R[..., 0, 2] alone is a matrix with one entry that is not zero.
    """

    R_WH: Any = None
    p_WH: Any = None
    q: Any = None
    R_WLs: Any = None
    p_WLs: Any = None
    palm_W: Any = None
    tips_W: Any = None
    centers_W: Any = None
    distances: Any = None
    heights: Any = None
    between_W: Any = None
    contact_distances: Any = None
    contacts_W: Any = None
    normals_W: Any = None
    pads_W: Any = None

    def given(self) -> dict[str, Any]:
        """The gradients that are not zero, by name."""
        return {name: gradient for name in NAMES if (gradient := getattr(self, name)) is not None}


NAMES = tuple(field.name for field in fields(Pull))
"""What can be pulled."""


class Term(Protocol):
    """An energy term: weight times a value.

    Frozen dataclasses of plain fields serve best: they can be compared, printed, and sent to other processes.
    """

    @property
    def name(self) -> str:
        """Name in tables and results, unique among the terms of a program."""
        ...

    @property
    def weight(self) -> float:
        """Weight."""
        ...

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """The term, without its weight.

        Args:
            view: What kinematics and distances give.

        Returns:
            Value, shape (...), and its gradient.
        """
        ...


def evaluate_term(term: Term, view: View) -> tuple[Any, dict[str, Any]]:
    """What a term gives, with its shapes checked: a wrong one would be broadcast without a word.

    Args:
        term: The term.
        view: The view.

    Returns:
        Value, shape (...), and gradients by name.

    Raises:
        ConfigError: A value or a gradient has not the shape that it must have.
    """
    value, pull = term.evaluate(view)
    _check_shape(term, "its value", value, view.q.shape[:-1])
    gradients = pull.given()
    for name, gradient in gradients.items():
        _check_shape(term, f"its pull on {name}", gradient, getattr(view, name).shape)
    return value, gradients


def _check_shape(term: Term, what: str, array: Any, shape: Sequence[int]) -> None:
    if getattr(array, "shape", ()) != shape:
        raise ConfigError(
            f"term {term.name!r}: {what} has shape {tuple(np.shape(array))}; give {tuple(shape)}, as the view has it"
        )


Pulls = Mapping[str, Any]
"""Gradients of a sum of terms by the name of what they are with respect to."""


def add_pull(total: dict[str, Any], weight: float, gradients: Mapping[str, Any]) -> None:
    """Adds the weighted gradients of a term to those of others, in place."""
    for name, gradient in gradients.items():
        total[name] = weight * gradient if name not in total else total[name] + weight * gradient


def carried(pulls: Pulls, name: str, through: Callable[[Any], Any] = lambda gradient: gradient) -> Any:
    """The gradient with respect to one quantity, carried on by a linear map; None where nothing pulls."""
    gradient = pulls.get(name)
    return None if gradient is None else through(gradient)
