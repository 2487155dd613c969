"""Batched multi-start: many candidates descend the energy of Eq. (1) together.

Every candidate has its own approach, posture and contact set (which fingers shall touch). Gradients are analytic: terms
give gradients with respect to points, the kinematics' adjoint carries them to wrist and joints, and Adam steps on the
tangent. Distances come from the object's grid; the polish that follows uses exact ones.
"""

from xdex_drake.programs.search.candidates import Candidates, State
from xdex_drake.programs.search.descent import descend, refine, search
from xdex_drake.programs.search.problem import SearchProblem, search_problem
from xdex_drake.programs.search.settings import EnergyWeights, SearchSettings
from xdex_drake.programs.search.starts import places_in, random_rotations, sample_starts, turned_towards
from xdex_drake.programs.search.view import evaluate

__all__ = [
    "Candidates",
    "EnergyWeights",
    "SearchProblem",
    "SearchSettings",
    "State",
    "descend",
    "evaluate",
    "places_in",
    "random_rotations",
    "refine",
    "sample_starts",
    "search",
    "search_problem",
    "turned_towards",
]
