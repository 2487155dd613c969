"""One term in the search and in a program: the same values, pulls carried back rightly, a user's own in both."""

import pickle
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch

from tests.programs.test_search import Ball
from xdex_drake.errors import ConfigError
from xdex_drake.hand.batched_kinematics import rotation_step
from xdex_drake.programs.arrays import like
from xdex_drake.programs.costs import EnergyCost, squared
from xdex_drake.programs.force_closure import polish_program, program_of_candidate
from xdex_drake.programs.grasp_types import finger_tips
from xdex_drake.programs.point_view import PointView
from xdex_drake.programs.search import SearchSettings, State, evaluate, sample_starts, search, search_problem
from xdex_drake.programs.search.view import BatchView
from xdex_drake.programs.solve import solve
from xdex_drake.programs.term import NAMES, Pull, View
from xdex_drake.programs.terms import EQ_1
from xdex_drake.programs.terms.approach import Approach
from xdex_drake.programs.terms.force_closure import NormalClosure
from xdex_drake.programs.terms.keypoints import Tips
from xdex_drake.programs.terms.spread import Spread
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@dataclass(frozen=True)
class Linear:
    """A random linear function of one quantity of the view, whose pull is right by construction."""

    name: str
    weight: float = 1.0

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        quantity = getattr(view, self.name)
        shape = quantity.shape[view.q.ndim - 1 :]
        c = 0.0 * quantity + like(quantity, np.random.default_rng(0).normal(size=shape))
        axes = tuple(range(view.q.ndim - 1, quantity.ndim))
        return (c * quantity).sum(axes), Pull(**{self.name: c})


@dataclass(frozen=True)
class Level:
    """A user's own: the wrist's z axis is horizontal."""

    weight: float = 20.0
    name: str = "level"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        up = view.R_WH[..., 2, 2]
        pull = 0.0 * view.R_WH
        pull[..., 2, 2] = 2.0 * up
        return up**2, Pull(R_WH=pull)


@dataclass(frozen=True)
class Wrong:
    """A term whose gradient has a wrong shape."""

    weight: float = 1.0
    name: str = "wrong"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        return view.q.sum(-1), Pull(q=1.0 + 0.0 * view.q[..., :1])


@pytest.fixture(scope="module")
def point(allegro, can_scene):
    found = search(allegro, can_scene, count=8, seed=0)
    program = program_of_candidate(allegro, can_scene, found, 0)
    return program.start.moved(1e-2 * np.random.default_rng(1).normal(size=program.start.size))


def _touching(hand, point):
    touching = np.zeros(len(hand.fingers), dtype=bool)
    touching[point.contacts.fingers] = True
    return touching


def slope_along(cost, point, step, h=1e-6):
    return (cost.value(point.moved(h * step)) - cost.value(point.moved(-h * step))) / (2 * h)


@pytest.mark.parametrize("name", NAMES)
def test_pulls_at_a_point_agree_with_differences(name, point):
    # Contact points come from a grid whose distance and normals do not belong together exactly.
    limit = 5e-2 if name == "contacts_W" else 1e-4
    cost = EnergyCost(Linear(name))
    gradient = cost.gradient(point)
    assert gradient[point.moving :] == pytest.approx(0.0)
    numeric = np.array([slope_along(cost, point, d) for d in np.eye(point.size)[: point.moving]])
    assert np.abs(gradient[: point.moving] - numeric).max() <= limit * np.abs(numeric).max()


@pytest.mark.parametrize("name", NAMES)
def test_pulls_of_a_batch_agree_with_differences(name, allegro, can_scene):
    settings = replace(SearchSettings(), terms=(Linear(name),))
    problem = search_problem(allegro, can_scene, settings, dtype=torch.float64)
    problem = replace(problem, grid=Ball(can_scene.object.p_OOcm, 0.04))
    state = sample_starts(problem, allegro, can_scene, 4, 0)
    _, gradient, _ = evaluate(problem, replace(state))
    numeric, h = torch.zeros_like(gradient), 1e-6
    for c in range(gradient.shape[1]):
        d = torch.zeros_like(gradient)
        d[:, c] = h
        ahead, behind = (
            replace(
                state,
                R_WH=rotation_step(state.R_WH, s * d[:, :3]),
                p_WH=state.p_WH + s * d[:, 3:6],
                q=state.q + s * d[:, 6:],
            )
            for s in (1.0, -1.0)
        )
        numeric[:, c] = (evaluate(problem, ahead)[0] - evaluate(problem, behind)[0]) / (2 * h)
    assert float((gradient - numeric).abs().max()) <= 1e-5 * float(numeric.abs().max())


def test_every_term_serves_a_program(allegro):
    scene = make_scene(load_object("ball"))
    found = search(allegro, scene, count=8, seed=0, settings=replace(SearchSettings(), iterations=40))
    point = program_of_candidate(allegro, scene, found, 0).start
    terms = (*EQ_1, NormalClosure(name="normals"), Approach((1.0, 0.2, 0.0)), Spread(0.1), Level())
    terms = (*terms, Tips(tuple(map(tuple, point.k.points(*finger_tips(allegro)) + 0.02))))
    # Without the thumb, so that forces are far from balanced.
    touching = found.fingers[0] & np.array([finger.name != "thumb" for finger in allegro.fingers])
    program = polish_program(allegro, scene, point.k.X_WH, point.k.q, touching)
    for term in terms:
        program.add(term)
    point = program.start
    descriptions = {b.evaluator().get_description() for b in program.prog.GetAllCosts()}
    for cost in program.costs[-len(terms) :]:
        assert cost.name in descriptions and cost.name in str(program)
        gradient = cost.gradient(point)[: point.moving]
        numeric = np.array([slope_along(cost, point, d) for d in np.eye(point.size)[: point.moving]])
        # Those of contact points, see above; of forces, which are near the best only.
        limit = 0.1 if cost.name in ("fc", "normals", "spread") else 1e-4
        assert np.abs(gradient - numeric).max() <= limit * max(np.abs(numeric).max(), 1e-3), cost.name


def test_search_and_program_agree_on_every_term(allegro, can_scene, point):
    """The same configuration and contact spheres: what differs is the grid from the exact distance."""
    problem = search_problem(allegro, can_scene, dtype=torch.float64)
    touching = torch.tensor(_touching(allegro, point)[None].astype(float))
    state = State(
        torch.tensor(point.k.X_WH.rotation().matrix()[None]),
        torch.tensor(point.k.X_WH.translation()[None]),
        torch.tensor(point.k.q[None]),
        touching,
        torch.zeros((1, touching.shape[1], 3), dtype=torch.float64),
    )
    batch, one = BatchView(problem, state), PointView.of(point)
    chosen = touching[0] > 0.5
    for name in ("R_WH", "p_WH", "q", "R_WLs", "p_WLs", "palm_W", "tips_W", "centers_W", "heights", "between_W"):
        assert getattr(batch, name)[0].numpy() == pytest.approx(getattr(one, name), abs=1e-9), name
    near = one.distances < 0.02
    assert batch.distances[0].numpy()[near] == pytest.approx(one.distances[near], abs=1.5e-3)
    assert batch.pads_W[0][chosen].numpy() == pytest.approx(one.pads_W, abs=1e-9)
    assert batch.contact_radii[0][chosen].numpy() == pytest.approx(one.contact_radii)
    assert batch.contacts_W[0][chosen].numpy() == pytest.approx(one.contacts_W, abs=1e-6)
    assert batch.normals_W[0][chosen].numpy() == pytest.approx(one.normals_W, abs=1e-6)


def test_a_users_own_term_in_the_search_and_in_the_program(allegro, can_scene):
    mine = Level()
    settings = replace(SearchSettings(), iterations=60)
    plain = search(allegro, can_scene, count=24, seed=0, settings=settings)
    found = search(allegro, can_scene, count=24, seed=0, settings=replace(settings, terms=(*EQ_1, mine)))
    assert set(found.terms) == {*plain.terms, "level"}
    assert found.terms["level"] == pytest.approx(found.R_WHs[:, 2, 2] ** 2, abs=1e-5)
    assert np.median(found.terms["level"]) < 0.2 * np.median(plain.R_WHs[:, 2, 2] ** 2)
    program = program_of_candidate(allegro, can_scene, plain, 0)
    before = solve(program).point
    program.add(mine)
    program.add(squared(replace(mine, name="level squared"), 20.0))
    result = solve(program)
    assert {"level", "level squared"} <= set(result.costs)
    assert result.point.k.X_WH.rotation().matrix()[2, 2] ** 2 < before.k.X_WH.rotation().matrix()[2, 2] ** 2


def test_wrong_terms_are_named(allegro, can_scene, point):
    with pytest.raises(ConfigError, match=r"'wrong'.*pull on q.*\(8, 1\).*\(8, 16\)"):
        search(allegro, can_scene, count=8, settings=replace(SearchSettings(), terms=(*EQ_1, Wrong())))
    with pytest.raises(ConfigError, match="'wrong'"):
        EnergyCost(Wrong()).value(point)
    with pytest.raises(ConfigError, match="two are named 'level'"):
        search(allegro, can_scene, settings=replace(SearchSettings(), terms=(Level(), Level())))


def test_settings_with_terms_travel_to_other_processes():
    settings = replace(SearchSettings(), terms=(*EQ_1, Approach((0.0, 0.0, -1.0)), Spread(0.02)))
    assert pickle.loads(pickle.dumps(settings)) == settings


def test_weights_of_settings_replace_the_terms_own():
    settings = SearchSettings()
    other = replace(settings, weights=replace(settings.weights, sdf=7.0, approach=4.0), approach=(0.0, 0.0, -1.0))
    weights = {term.name: weight for weight, term in other.energy()}
    assert weights == {**{term.name: term.weight for term in EQ_1}, "sdf": 7.0, "approach": 4.0}
