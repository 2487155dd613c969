"""The balance program: closed forms, the same program in cvxpy, in Drake and linearised, and its laws."""

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver

from tests.contact.references import MU, RADIUS, balance_reference, ball_grasp, grasp_map, matrix, ring_grasp, scaled
from xdex_drake.contact import (
    Effort,
    GraspMap,
    balance,
    balance_linearized,
    balance_program,
    cone_violation,
    contact_frames,
    gravity_wrench,
)
from xdex_drake.errors import ConfigError

MASS = 0.1
WEIGHT = MASS * 9.81
F_EXT = gravity_wrench(MASS)


def norm(f):
    return float(np.linalg.norm(f))


@pytest.mark.parametrize("mu", [0.3, 0.6, 1.0])
def test_antipodal_pinch_squeezes_by_half_the_weight_over_mu(mu):
    result = balance(grasp_map(*ring_grasp(2), mu=mu), F_EXT)
    assert result.solved and result.residual <= 1e-9
    assert result.f.reshape(2, 3)[:, 2] == pytest.approx(WEIGHT / (2 * mu), rel=1e-6)


def test_three_symmetric_fingers_share_the_weight():
    result = balance(grasp_map(*ring_grasp(3)), F_EXT)
    f = result.f.reshape(3, 3)
    assert f[:, 2] == pytest.approx(WEIGHT / (3 * MU), rel=1e-6)
    assert np.hypot(f[:, 0], f[:, 1]) == pytest.approx(WEIGHT / 3, rel=1e-6)


def test_one_contact_below_holds_and_one_at_the_side_does_not():
    below = balance(grasp_map([[0.0, 0.0, -RADIUS]], [[0.0, 0.0, 1.0]]), F_EXT)
    assert below.solved and below.f == pytest.approx([0.0, 0.0, WEIGHT], abs=1e-8)
    side = balance(grasp_map([[RADIUS, 0.0, 0.0]], [[-1.0, 0.0, 0.0]]), F_EXT)
    assert side.status == "infeasible" and "friction" in side.reason and np.isnan(side.f).all()


def test_no_contact_is_a_result():
    result = balance(GraspMap(np.zeros((6, 0)), MU, RADIUS), F_EXT)
    assert result.status == "infeasible" and "no contact" in result.reason


def test_no_wrench_needs_no_force():
    result = balance(grasp_map(*ring_grasp(3)), np.zeros(6))
    assert result.solved and norm(result.f) < 1e-6


def test_efforts_refuse_by_name():
    three = grasp_map(*ring_grasp(3))
    free = balance(three, F_EXT)
    result = balance(three, F_EXT, effort=Effort(np.eye(9), np.full(9, 0.9 * np.abs(free.f).max())))
    assert result.status == "infeasible" and "effort" in result.reason
    unlimited = balance(three, F_EXT, effort=Effort(np.eye(9), np.full(9, np.inf)))
    assert unlimited.f == pytest.approx(free.f)
    dead = balance(three, F_EXT, effort=Effort(np.ones((1, 9)), np.zeros(1)))
    assert not dead.solved or abs(dead.f.sum()) < 1e-6
    weak = balance(three, F_EXT, effort=Effort.of_normal_forces(3, 0.99 * free.f[2]))
    strong = balance(three, F_EXT, effort=Effort.of_normal_forces(3, 1.01 * free.f[2]))
    assert not weak.solved and strong.f == pytest.approx(free.f)


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_against_cvxpy_drake_and_pyramids(n):
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(n)
    outcomes = set()
    for _ in range(8):
        p, normals = ring_grasp(2) if n == 2 else ball_grasp(rng, n)
        touch, G = grasp_map(p, normals), matrix(p, normals)
        A, limits = rng.normal(size=(5, 3 * n)) * RADIUS, rng.uniform(0.02, 0.2, 5)
        options = {"effort": Effort(A, limits), "min_normal": 0.05}
        expected = balance_reference(cvxpy, G, MU, F_EXT, RADIUS, A, limits, 0.05)
        result = balance(touch, F_EXT, **options)
        program = balance_program(touch, F_EXT, **options)
        in_drake = ClarabelSolver().Solve(program)
        outcomes.add(result.status)
        assert result.solved == (expected is not None) == in_drake.is_success()
        linear = balance_linearized(touch, F_EXT, edges=16, **options)
        if not result.solved:
            assert not linear.solved  # pyramids are subsets of cones
            continue
        assert result.f == pytest.approx(expected, abs=2e-4)
        assert in_drake.GetSolution(program.decision_variables()) == pytest.approx(result.f, abs=2e-4)
        assert cone_violation(result.f.reshape(-1, 3), MU).max() <= 1e-8
        assert np.all(np.abs(A @ result.f) <= limits + 1e-8)
        assert norm(scaled((G @ result.f + F_EXT)[:, None], RADIUS)) <= 1e-12  # by construction, not by tolerance
        if linear.solved:
            assert norm(linear.f) >= norm(result.f) - 1e-8
            assert cone_violation(linear.f.reshape(-1, 3), MU).max() <= 1e-8
    assert n == 2 or outcomes == {"solved", "infeasible"}


def test_rigid_motions_and_the_order_of_contacts_do_not_matter():
    rng = np.random.default_rng(11)
    p, normals = ring_grasp(4)
    p, normals = p + 0.003 * rng.normal(size=p.shape), normals + 0.1 * rng.normal(size=p.shape)
    base = balance(grasp_map(p, normals), F_EXT)
    R, t, order = contact_frames(rng.normal(size=3)), rng.normal(size=3), rng.permutation(4)
    moved_F = np.concatenate([R @ F_EXT[:3], R @ F_EXT[3:]])
    moved = balance(grasp_map((p @ R.T + t)[order], (normals @ R.T)[order], t), moved_F)
    assert base.solved and norm(moved.f) == pytest.approx(norm(base.f), rel=1e-7)
    assert moved.f.reshape(4, 3)[:, 2] == pytest.approx(base.f.reshape(4, 3)[order, 2], abs=1e-6)
    # The length weighs torques against forces: it must not change what balances exactly.
    assert balance(grasp_map(p, normals, length=5 * RADIUS), F_EXT).f == pytest.approx(base.f, abs=1e-6)


def test_more_friction_never_needs_more_force():
    rng = np.random.default_rng(12)
    for _ in range(5):
        p, normals = ball_grasp(rng, 4)
        forces = [balance(grasp_map(p, normals, mu=mu), F_EXT) for mu in (0.2, 0.4, 0.8, 1.6)]
        norms = [norm(r.f) if r.solved else np.inf for r in forces]
        assert np.all(np.diff([v for v in norms if np.isfinite(v)]) <= 1e-7)
        assert sorted(np.isfinite(norms)) == list(np.isfinite(norms))


def test_a_least_normal_force_and_spared_friction_are_kept():
    f = balance(grasp_map(*ring_grasp(3)), F_EXT, safety=0.55, min_normal=1.0).f.reshape(3, 3)
    assert f[:, 2].min() >= 1.0 - 1e-7 and cone_violation(f, 0.55 * MU).max() <= 1e-7


def test_bad_input_names_the_field():
    G, A = matrix(*ring_grasp(3)), np.eye(9)
    refused = {
        "G": lambda: GraspMap(G[:5], MU, 1.0),
        "mu": lambda: GraspMap(G, np.array([0.5, 0.5]), 1.0),
        "length": lambda: GraspMap(G, MU, 0.0),
        "finite": lambda: GraspMap(np.nan * G, MU, 1.0),
        "limits >= 0": lambda: Effort(A, -np.ones(9)),
        "for 3 contacts": lambda: balance(GraspMap(G, MU, 1.0), F_EXT, effort=Effort(np.eye(6), np.ones(6))),
        "edges": lambda: balance_linearized(GraspMap(G, MU, 1.0), F_EXT, edges=2),
        "solver": lambda: balance_linearized(GraspMap(G, MU, 1.0), F_EXT, solver="none"),
    }
    for words, call in refused.items():
        with pytest.raises(ConfigError, match=words):
            call()


def test_two_contacts_off_the_center_of_mass_are_refused_not_undecided():
    rng = np.random.default_rng(13)
    for _ in range(40):
        p, normals = ball_grasp(rng, 2)
        assert balance(grasp_map(p, normals, 0.002 * rng.normal(size=3)), F_EXT).status == "infeasible"
