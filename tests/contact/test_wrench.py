"""The balance program: closed forms, the same program in cvxpy, in Drake and linearised, and its laws."""

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver

from tests.contact.references import RADIUS, balance_reference, ball_grasp, matrix, ring_grasp, scaled
from xdex_drake.contact import (
    balance,
    balance_linearized,
    balance_program,
    cone_violation,
    contact_frames,
    gravity_wrench,
    squeeze_forces,
)
from xdex_drake.errors import ConfigError

MU, MASS = 0.6, 0.1
WEIGHT = MASS * 9.81
F_EXT = gravity_wrench(MASS)


def norm(f):
    return float(np.linalg.norm(f))


@pytest.mark.parametrize("mu", [0.3, 0.6, 1.0])
def test_antipodal_pinch_squeezes_by_half_the_weight_over_mu(mu):
    G = matrix(*ring_grasp(2))
    result = balance(G, mu, F_EXT, length=RADIUS)
    assert result.solved and result.residual <= 1e-9
    assert result.f.reshape(2, 3)[:, 2] == pytest.approx(WEIGHT / (2 * mu), rel=1e-6)


def test_three_symmetric_fingers_share_the_weight():
    result = balance(matrix(*ring_grasp(3)), MU, F_EXT, length=RADIUS)
    f = result.f.reshape(3, 3)
    assert f[:, 2] == pytest.approx(WEIGHT / (3 * MU), rel=1e-6)
    assert np.hypot(f[:, 0], f[:, 1]) == pytest.approx(WEIGHT / 3, rel=1e-6)


def test_one_contact_below_holds_and_one_at_the_side_does_not():
    below = balance(matrix([[0.0, 0.0, -RADIUS]], [[0.0, 0.0, 1.0]]), MU, F_EXT, length=RADIUS)
    assert below.solved and below.f == pytest.approx([0.0, 0.0, WEIGHT], abs=1e-8)
    side = balance(matrix([[RADIUS, 0.0, 0.0]], [[-1.0, 0.0, 0.0]]), MU, F_EXT, length=RADIUS)
    assert side.status == "infeasible" and "friction" in side.reason and np.isnan(side.f).all()


def test_no_contact_is_a_result():
    result = balance(np.zeros((6, 0)), MU, F_EXT, length=RADIUS)
    assert result.status == "infeasible" and "no contact" in result.reason


def test_no_wrench_needs_no_force():
    result = balance(matrix(*ring_grasp(3)), MU, np.zeros(6), length=RADIUS)
    assert result.solved and norm(result.f) < 1e-6


def test_efforts_refuse_by_name():
    G = matrix(*ring_grasp(3))
    free = balance(G, MU, F_EXT, length=RADIUS)
    result = balance(G, MU, F_EXT, A=np.eye(9), effort=np.full(9, 0.9 * np.abs(free.f).max()), length=RADIUS)
    assert result.status == "infeasible" and "effort" in result.reason
    unlimited = balance(G, MU, F_EXT, A=np.eye(9), effort=np.full(9, np.inf), length=RADIUS)
    assert unlimited.f == pytest.approx(free.f)
    dead = balance(G, MU, F_EXT, A=np.ones((1, 9)), effort=np.zeros(1), length=RADIUS)
    assert not dead.solved or abs(dead.f.sum()) < 1e-6


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_against_cvxpy_drake_and_pyramids(n):
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(n)
    outcomes = set()
    for _ in range(8):
        p, normals = ring_grasp(2) if n == 2 else ball_grasp(rng, n)
        G = matrix(p, normals)
        A, effort = rng.normal(size=(5, 3 * n)) * RADIUS, rng.uniform(0.02, 0.2, 5)
        options = {"A": A, "effort": effort, "length": RADIUS, "min_normal": 0.05}
        expected = balance_reference(cvxpy, G, MU, F_EXT, RADIUS, A, effort, 0.05)
        result = balance(G, MU, F_EXT, **options)
        program = balance_program(G, MU, F_EXT, **options)
        in_drake = ClarabelSolver().Solve(program)
        outcomes.add(result.status)
        assert result.solved == (expected is not None) == in_drake.is_success()
        linear = balance_linearized(G, MU, F_EXT, edges=16, **options)
        if not result.solved:
            assert not linear.solved  # pyramids are subsets of cones
            continue
        assert result.f == pytest.approx(expected, abs=2e-4)
        assert in_drake.GetSolution(program.decision_variables()) == pytest.approx(result.f, abs=2e-4)
        assert cone_violation(result.f.reshape(-1, 3), MU).max() <= 1e-8
        assert np.all(np.abs(A @ result.f) <= effort + 1e-8)
        assert norm(scaled((G @ result.f + F_EXT)[:, None], RADIUS)) <= 1e-12  # by construction, not by tolerance
        if linear.solved:
            assert norm(linear.f) >= norm(result.f) - 1e-8
            assert cone_violation(linear.f.reshape(-1, 3), MU).max() <= 1e-8
    assert n == 2 or outcomes == {"solved", "infeasible"}


def test_rigid_motions_and_the_order_of_contacts_do_not_matter():
    rng = np.random.default_rng(11)
    p, normals = ring_grasp(4)
    p, normals = p + 0.003 * rng.normal(size=p.shape), normals + 0.1 * rng.normal(size=p.shape)
    base = balance(matrix(p, normals), MU, F_EXT, length=RADIUS)
    R, t, order = contact_frames(rng.normal(size=3)), rng.normal(size=3), rng.permutation(4)
    moved_F = np.concatenate([R @ F_EXT[:3], R @ F_EXT[3:]])
    moved = balance(matrix((p @ R.T + t)[order], (normals @ R.T)[order], t), MU, moved_F, length=RADIUS)
    assert base.solved and norm(moved.f) == pytest.approx(norm(base.f), rel=1e-7)
    assert moved.f.reshape(4, 3)[:, 2] == pytest.approx(base.f.reshape(4, 3)[order, 2], abs=1e-6)
    # The length weighs torques against forces: it must not change what balances exactly.
    assert balance(matrix(p, normals), MU, F_EXT, length=5 * RADIUS).f == pytest.approx(base.f, abs=1e-6)


def test_more_friction_never_needs_more_force():
    rng = np.random.default_rng(12)
    for _ in range(5):
        G = matrix(*ball_grasp(rng, 4))
        forces = [balance(G, mu, F_EXT, length=RADIUS) for mu in (0.2, 0.4, 0.8, 1.6)]
        norms = [norm(r.f) if r.solved else np.inf for r in forces]
        assert np.all(np.diff([v for v in norms if np.isfinite(v)]) <= 1e-7)
        assert sorted(np.isfinite(norms)) == list(np.isfinite(norms))


def test_weights_move_force_between_contacts():
    G = matrix(*ring_grasp(3))
    f = balance(G, MU, F_EXT, length=RADIUS, weight=[100.0, 1.0, 1.0]).f.reshape(3, 3)
    assert np.linalg.norm(f[0]) <= np.linalg.norm(f[1]) + 1e-9


def test_weighted_forces_against_cvxpy():
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(14)
    weights = np.array([5.0, 1.0, 2.0, 0.5])
    G = matrix(*ring_grasp(4)) + 1e-4 * rng.normal(size=(6, 12))
    f = cvxpy.Variable(12)
    rows = [G @ f + F_EXT == 0, *[cvxpy.norm(f[3 * i : 3 * i + 2]) <= MU * f[3 * i + 2] for i in range(4)]]
    cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(cvxpy.multiply(np.sqrt(np.repeat(weights, 3)), f))), rows).solve(
        "CLARABEL"
    )
    assert balance(G, MU, F_EXT, length=RADIUS, weight=weights).f == pytest.approx(f.value, abs=1e-4)


def test_squeeze_steps_down_only_as_far_as_needed():
    G = matrix(*ring_grasp(3))
    first = squeeze_forces(G, MU, F_EXT, length=RADIUS, min_normal=1.0)
    assert (first.safety, first.min_normal) == (0.55, 1.0)
    f = first.f.reshape(3, 3)
    assert f[:, 2].min() >= 1.0 - 1e-7 and cone_violation(f, 0.55 * MU).max() <= 1e-7
    # Limit the normal forces (z components) below what safety 0.55 needs, WEIGHT / (3 * 0.55 * MU) = 0.99 N.
    A = np.zeros((3, 9))
    A[np.arange(3), 3 * np.arange(3) + 2] = 1.0
    steps = {0.8: (0.7, 0.8), 0.6: (1.0, 0.6), 0.56: (1.0, 0.3)}
    for limit, used in steps.items():
        result = squeeze_forces(
            G,
            MU,
            F_EXT,
            A=A,
            effort=np.full(3, limit),
            length=RADIUS,
            min_normal=min(limit, 0.6) if used[1] == 0.3 else used[1],
        )
        assert result.solved and result.safety == used[0]
        assert np.abs(A @ result.f).max() <= limit + 1e-7
    hopeless = squeeze_forces(G, MU, F_EXT, A=A, effort=np.full(3, 0.5), length=RADIUS)
    assert not hopeless.solved and hopeless.reason


@pytest.mark.parametrize("bad", ["G", "mu", "length", "effort", "alone", "nan"])
def test_bad_input_names_the_field(bad):
    G = matrix(*ring_grasp(3))
    calls = {
        "G": lambda: balance(G[:5], MU, F_EXT, length=1.0),
        "mu": lambda: balance(G, [0.5, 0.5], F_EXT, length=1.0),
        "length": lambda: balance(G, MU, F_EXT, length=0.0),
        "effort": lambda: balance(G, MU, F_EXT, A=np.eye(9), effort=-np.ones(9), length=1.0),
        "alone": lambda: balance(G, MU, F_EXT, A=np.eye(9), length=1.0),
        "nan": lambda: balance(np.nan * G, MU, F_EXT, length=1.0),
    }
    with pytest.raises(ConfigError, match={"alone": "both or neither", "nan": "finite"}.get(bad, bad)):
        calls[bad]()


def test_two_contacts_off_the_center_of_mass_are_refused_not_undecided():
    rng = np.random.default_rng(13)
    for _ in range(40):
        p, normals = ball_grasp(rng, 2)
        assert balance(matrix(p, normals, 0.002 * rng.normal(size=3)), MU, F_EXT, length=RADIUS).status == "infeasible"
