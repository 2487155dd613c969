"""Candidates of a search, on their way down as tensors and at its end as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from xdex_drake.arrays import Array


@dataclass(frozen=True)
class Candidates:
    """Results of a search, best first.

    Attributes:
        R_WHs: Wrist rotations, shape (B, 3, 3).
        p_WHs: Wrist origins [m], shape (B, 3).
        qs: Actuated joint values [rad or m], shape (B, n).
        fingers: Which slots shall touch: the fingers, in the order of `hand.fingers`, and for a power grasp the
            palm, shape (B, n_slots).
        energy: Total energy, shape (B,).
        terms: Unweighted value of each term, each of shape (B,).
    """

    R_WHs: Array
    p_WHs: Array
    qs: Array
    fingers: NDArray[np.bool_]
    energy: Array
    terms: dict[str, Array]

    def take(self, rows: NDArray[np.int64] | slice) -> Candidates:
        """Some of the candidates, in the order given."""
        terms = {name: values[rows] for name, values in self.terms.items()}
        fingers, energy = self.fingers[rows], self.energy[rows]
        return Candidates(self.R_WHs[rows], self.p_WHs[rows], self.qs[rows], fingers, energy, terms)

    def __repr__(self) -> str:
        """One line."""
        energy = f"energy {self.energy.min():.3g} to {self.energy.max():.3g}" if len(self.energy) else "none"
        return f"Candidates({len(self.energy)}, {energy})"


@dataclass
class State:
    """Candidates on their way down; updated in place by `descend`.

    Attributes:
        R_WH: Wrist rotations, shape (B, 3, 3).
        p_WH: Wrist origins [m], shape (B, 3).
        q: Joint values, shape (B, n).
        fingers: 1 where a slot shall touch, shape (B, n_slots).
        forces: Contact forces in W, warm-started from step to step, shape (B, n_slots, 3).
    """

    R_WH: torch.Tensor
    p_WH: torch.Tensor
    q: torch.Tensor
    fingers: torch.Tensor
    forces: torch.Tensor

    def keep(self, rows: torch.Tensor) -> None:
        """Drops all candidates but some, given by their indices."""
        for name in ("R_WH", "p_WH", "q", "fingers", "forces"):
            setattr(self, name, getattr(self, name)[rows])


def candidates_of_state(
    state: State, energy: torch.Tensor, values: dict[str, torch.Tensor], order: torch.Tensor
) -> Candidates:
    """Candidates in NumPy, in the given order."""

    def array(t: torch.Tensor) -> Array:
        return t[order].cpu().numpy().astype(float)

    return Candidates(
        R_WHs=array(state.R_WH),
        p_WHs=array(state.p_WH),
        qs=array(state.q),
        fingers=array(state.fingers) > 0.5,
        energy=array(energy),
        terms={name: array(value) for name, value in values.items()},
    )
