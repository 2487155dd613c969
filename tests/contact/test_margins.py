"""Task margin, ball margin and the linearised qualities."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.contact.references import (
    MU,
    RADIUS,
    ball_grasp,
    grasp_map,
    matrix,
    reach_reference,
    ring_grasp,
    scaled,
    task_reference,
)
from xdex_drake.contact import (
    Effort,
    GraspMap,
    ball_margin,
    cone_edges,
    cone_violation,
    contact_frames,
    epsilon_linearized,
    gravity_wrench,
    min_weight,
    push_wrenches,
    support,
    task_margin,
)
from xdex_drake.contact.hull import GrowingHull
from xdex_drake.errors import ConfigError

MASS = 0.1
F_EXT, PUSHES = gravity_wrench(MASS), push_wrenches(MASS)


# --- task margin


def test_one_contact_below_resists_a_push_as_friction_allows():
    # Pushes sideways at the center of mass turn the ball about one contact: none is resisted.
    result = task_margin(grasp_map([[0.0, 0.0, -RADIUS]], [[0.0, 0.0, 1.0]]), F_EXT, PUSHES)
    assert result.status == "solved" and result.margin == pytest.approx(0.0, abs=1e-6)
    assert result.margins[4] == pytest.approx(1.0, abs=1e-5)  # up: until the weight is lifted
    assert result.margins[5] == pytest.approx(100.0)  # down: the cap


def test_gravity_that_is_not_held_has_margin_zero():
    result = task_margin(grasp_map([[RADIUS, 0, 0]], [[-1.0, 0, 0]]), F_EXT, PUSHES)
    assert result.status == "infeasible" and result.margin == 0.0 and "gravity" in result.reason
    assert task_margin(GraspMap(np.zeros((6, 0)), MU, RADIUS), F_EXT, PUSHES).margin == 0.0


def test_against_one_program_in_cvxpy():
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(0)
    seen = []
    for n in (3, 4, 5):
        for _ in range(3):
            G = matrix(*ball_grasp(rng, n))
            A, limits = rng.normal(size=(6, 3 * n)) * RADIUS, rng.uniform(0.05, 0.4, 6)
            result = task_margin(GraspMap(G, MU, RADIUS), F_EXT, PUSHES, effort=Effort(A, limits))
            expected = task_reference(cvxpy, G, MU, F_EXT, PUSHES, RADIUS, A, limits)
            assert result.margin == pytest.approx(expected, abs=1e-4)
            seen.append(expected)
            if result.status == "solved":
                # The forces prove the margins, without the solver.
                wrenches = result.forces @ G.T + F_EXT + result.margins[:, None] * PUSHES
                assert np.abs(scaled(wrenches.T, RADIUS)).max() <= 1e-6
                assert cone_violation(result.forces.reshape(6, n, 3), MU).max() <= 1e-7
                assert np.all(np.abs(result.forces @ A.T) <= limits + 1e-6)
    assert max(seen) > 0.0 and min(seen) == 0.0


def test_friction_raises_and_effort_limits_lower_the_task_margin():
    rng = np.random.default_rng(1)
    for _ in range(3):
        G = matrix(*ball_grasp(rng, 4))
        A = rng.normal(size=(6, 12)) * RADIUS

        def margin(mu, most, G=G, A=A):
            return task_margin(GraspMap(G, mu, RADIUS), F_EXT, PUSHES, effort=Effort(A, np.full(6, most))).margin

        by_friction = [margin(mu, 0.3) for mu in (0.3, 0.6, 1.0)]
        by_effort = [margin(MU, most) for most in (0.1, 0.3, 0.9)]
        assert np.all(np.diff(by_friction) >= -1e-6) and np.all(np.diff(by_effort) >= -1e-6)


def test_pinches_resist_what_their_line_allows():
    cvxpy = pytest.importorskip("cvxpy")
    p, normals = ring_grasp(2)
    pinch, G = grasp_map(p, normals), matrix(p, normals)
    result = task_margin(pinch, F_EXT, PUSHES, effort=Effort(np.eye(6), np.full(6, 2.0)))
    expected = task_reference(cvxpy, G, MU, F_EXT, PUSHES, RADIUS, np.eye(6), np.full(6, 2.0))
    assert result.status == "solved" and result.margin == pytest.approx(expected, abs=1e-5)
    # A torque about the line of the contacts is not resisted at all; gravity is, beside it.
    twist = np.append(p[1] - p[0], np.zeros(3))
    result = task_margin(pinch, F_EXT, [twist, PUSHES[0]], cap=10.0)
    assert result.status == "solved" and result.margin == result.margins[0] == 0.0 and result.margins[1] > 1.0
    assert G @ result.forces[0] + F_EXT == pytest.approx(0.0, abs=1e-12)


def test_pushes_are_the_weight_along_each_axis():
    assert PUSHES.sum(axis=0) == pytest.approx(0.0)
    assert np.linalg.norm(PUSHES, axis=1) == pytest.approx(MASS * 9.81)
    with pytest.raises(ConfigError, match="disturbances"):
        task_margin(grasp_map(*ring_grasp(3)), F_EXT, np.zeros((2, 5)))


# --- ball margin


def test_a_pinch_has_no_ball_and_says_so_at_once():
    pinch = grasp_map(*ring_grasp(2))
    result = ball_margin(pinch)
    assert result.lower == result.upper == 0.0 and result.iterations == 0
    assert support(pinch, result.direction[None])[0][0] == pytest.approx(0.0, abs=1e-9)


def test_support_is_the_greatest_wrench_component():
    rng = np.random.default_rng(2)
    G = scaled(matrix(*ball_grasp(rng, 4)), RADIUS)
    u = rng.normal(size=(20, 6))
    h, f = support(GraspMap(G, MU, 1.0), u)
    assert np.maximum(0.0, np.einsum("ij,ij->i", f @ G.T, u)) == pytest.approx(h)
    assert cone_violation(f.reshape(20, 4, 3), MU).max() <= 1e-12
    many = np.concatenate([G.reshape(6, 4, 3)[:, i] @ cone_edges(MU, 720) for i in range(4)], axis=1)
    assert h == pytest.approx(np.maximum(0.0, (u @ many).max(axis=1)), rel=1e-4)


@pytest.mark.parametrize("n", [3, 4, 6])
def test_bracket_is_true_and_tight(n):
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(n)
    closed = 0
    for _ in range(6):
        G = scaled(matrix(*ball_grasp(rng, n)), RADIUS)
        result = ball_margin(GraspMap(G, MU, 1.0))
        assert 0.0 <= result.lower <= result.upper <= result.lower + 1e-3 + 1e-12
        assert np.linalg.norm(result.direction) == pytest.approx(1.0)
        assert support(GraspMap(G, MU, 1.0), result.direction[None])[0][0] == pytest.approx(result.upper, abs=1e-9)
        if result.lower == 0.0:
            continue
        closed += 1
        # No wrench of the ball is out of reach, and the stated direction is the worst one.
        for u in [*rng.normal(size=(3, 6)), result.direction]:
            assert reach_reference(cvxpy, G, MU, u / np.linalg.norm(u)) >= result.lower - 1e-6
        witness = result.witness_forces
        axes = np.kron(np.eye(6), [[1.0], [-1.0]])
        assert witness @ G.T == pytest.approx(result.lower * axes, abs=1e-9)
        assert cone_violation(witness.reshape(12, n, 3), MU).max() <= 1e-9
        assert witness.reshape(12, n, 3)[..., 2].sum(axis=1).max() <= 1.0 + 1e-9
    assert closed


def test_no_direction_is_worse_than_the_lower_bound():
    rng = np.random.default_rng(9)
    G = scaled(matrix(*ball_grasp(rng, 5)), RADIUS)
    result = ball_margin(GraspMap(G, MU, 1.0))
    u = rng.normal(size=(20000, 6))
    h, _ = support(GraspMap(G, MU, 1.0), u / np.linalg.norm(u, axis=1, keepdims=True))
    assert h.min() >= result.lower


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.integers(3, 6))
def test_ball_margin_laws(seed, n):
    rng = np.random.default_rng(seed)
    p, normals = ball_grasp(rng, n)
    base = ball_margin(grasp_map(p, normals))
    assert base.upper - base.lower <= 1e-3 + 1e-12
    R, t, order = contact_frames(rng.normal(size=3)), rng.normal(size=3), rng.permutation(n)
    moved = ball_margin(grasp_map((p @ R.T + t)[order], (normals @ R.T)[order], t))
    assert moved.lower <= base.upper + 1e-9 and base.lower <= moved.upper + 1e-9
    # Size does not matter where length follows it; friction helps; pyramids are inside the cones.
    larger = ball_margin(grasp_map(3 * p, normals, length=3 * RADIUS))
    assert larger.lower <= base.upper + 1e-9 and base.lower <= larger.upper + 1e-9
    assert ball_margin(grasp_map(p, normals, mu=1.5 * MU)).upper >= base.lower - 1e-9
    assert epsilon_linearized(grasp_map(p, normals), edges=6) <= base.upper + 1e-9


@pytest.mark.parametrize("mu", [0.0, 0.6])
def test_witnesses_where_the_hull_has_flat_faces(mu):
    # The edges of all cones lie in one plane: that of a unit sum of normal forces.
    for n in (3, 4, 8):
        p, normals = ring_grasp(n)
        G = scaled(matrix(p, normals, [0.001, 0.002, 0.0]), RADIUS)
        result = ball_margin(GraspMap(G, mu, 1.0))
        axes = np.kron(np.eye(6), [[1.0], [-1.0]])
        assert result.witness_forces @ G.T == pytest.approx(result.lower * axes, abs=1e-9)
        assert cone_violation(result.witness_forces.reshape(12, n, 3), mu).max() <= 1e-9


@pytest.mark.parametrize("mu", [0.0, 0.6])
def test_symmetric_and_repeated_contacts(mu):
    faces = np.vstack([np.eye(3), -np.eye(3)])
    for p in (faces, np.vstack([faces, faces]), np.vstack([faces[:3]] * 3)):
        result = ball_margin(grasp_map(RADIUS * p, -p, mu=mu))
        assert result.lower <= result.upper
        assert mu > 0.0 or result.upper == pytest.approx(0.0, abs=1e-9)  # no friction: no torque on a ball
        assert result.upper - result.lower <= 1e-2


def test_growing_hull_agrees_with_qhull():
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(5)
    for d in (2, 3, 6):
        points = rng.normal(size=(30, d))
        hull = GrowingHull(points)
        for point in points:
            hull.add(point)
        live = np.isfinite(hull.offsets[: hull.size])
        reference = ConvexHull(points)
        assert live.sum() == len(reference.simplices)
        assert np.sort(hull.offsets[: hull.size][live]) == pytest.approx(np.sort(-reference.equations[:, -1]))
    with pytest.raises(ValueError, match="span"):
        GrowingHull(np.c_[rng.normal(size=(10, 2)), np.zeros(10)])


# --- linearised qualities


def test_pyramids_approach_the_cone():
    rng = np.random.default_rng(6)
    p, normals = ball_grasp(rng, 4)
    touch = grasp_map(p, normals)
    exact = ball_margin(touch)
    coarse, fine = (epsilon_linearized(touch, edges=k) for k in (4, 16))
    assert coarse <= fine + 1e-9 <= exact.upper + 2e-9
    assert fine >= 0.9 * exact.lower


def test_min_weight_against_cvxpy_and_closure():
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(7)
    for n in (3, 4, 5):
        G = matrix(*ball_grasp(rng, n))
        columns = np.concatenate(
            [scaled(G, RADIUS).reshape(6, n, 3)[:, i] @ cone_edges(MU, 4) for i in range(n)], axis=1
        )
        alpha, least = cvxpy.Variable(4 * n), cvxpy.Variable()
        rows = [columns @ alpha == 0, cvxpy.sum(alpha) == 1, alpha >= least]
        cvxpy.Problem(cvxpy.Maximize(least), rows).solve("CLARABEL")
        value = min_weight(GraspMap(G, MU, RADIUS))
        assert value == pytest.approx(float(least.value), abs=1e-6)
        assert value <= 1.0 / (4 * n) + 1e-9
        assert (value > 1e-7) == (epsilon_linearized(GraspMap(G, MU, RADIUS), edges=4) > 1e-7)
