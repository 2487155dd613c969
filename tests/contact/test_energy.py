"""The wrench energy and its envelope gradient."""

import numpy as np
import pytest

from tests.contact.references import RADIUS, ball_grasp, matrix, scaled
from xdex_drake.contact import (
    balance,
    ball_margin,
    ball_margin_gradient,
    epsilon_gradient,
    epsilon_linearized,
    gravity_wrench,
    min_weight,
    min_weight_gradient,
    wrench_energy,
)

MU = 0.6
F_EXT = gravity_wrench(0.1)


@pytest.mark.parametrize("bounds", [(0.0, np.inf), (0.2, 1.0)])
@pytest.mark.parametrize("n", [1, 3, 4])
def test_gradient_by_central_differences(n, bounds):
    rng = np.random.default_rng(n)
    for _ in range(3):
        p, normals = ball_grasp(rng, n)
        center = 0.01 * rng.normal(size=3)

        def energy(p, normals, center=center):
            return wrench_energy(p, normals, MU, F_EXT, center, length=RADIUS, normal_bounds=bounds)

        result = energy(p, normals)
        assert result.solved and result.value > 0.0
        dp, dn = rng.normal(size=(2, n, 3))
        dn -= (dn * normals).sum(axis=1, keepdims=True) * normals  # normals stay unit to first order
        for moved_p, moved_n, gradient in ((dp, 0 * dn, result.gradient_p), (0 * dp, dn, result.gradient_n)):
            slope = (gradient * (moved_p + moved_n)).sum()
            # Several steps: contacts start to slip within a large one, and the solver's rounding spoils a small one.
            differences = [
                (
                    energy(p + h * moved_p, normals + h * moved_n).value
                    - energy(p - h * moved_p, normals - h * moved_n).value
                )
                / (2 * h)
                for h in (1e-4, 1e-5, 1e-6)
            ]
            assert min(abs(slope - d) for d in differences) <= 1e-4 * abs(slope) + 1e-6
        assert (result.gradient_n * normals).sum(axis=1) == pytest.approx(0.0, abs=1e-9)


def test_energy_is_small_exactly_where_gravity_is_held():
    rng = np.random.default_rng(5)
    held = set()
    for _ in range(12):
        p, normals = ball_grasp(rng, 3)
        energy = wrench_energy(p, normals, MU, F_EXT, np.zeros(3), length=RADIUS, regularization=1e-7).value
        solved = balance(matrix(p, normals), MU, F_EXT, length=RADIUS).solved
        held.add(solved)
        assert (energy < 1e-3) == solved
    assert held == {True, False}


def test_against_cvxpy():
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(6)
    p, normals = ball_grasp(rng, 4)
    result = wrench_energy(p, normals, MU, F_EXT, np.zeros(3), length=RADIUS, normal_bounds=(0.1, 0.5))
    G, f = scaled(matrix(p, normals), RADIUS), cvxpy.Variable(12)
    rows = [cvxpy.norm(f[3 * i : 3 * i + 2]) <= MU * f[3 * i + 2] for i in range(4)]
    rows += [f[2::3] >= 0.1, f[2::3] <= 0.5]
    cost = 0.5 * cvxpy.sum_squares(G @ f + F_EXT) + 0.5e-3 * cvxpy.sum_squares(f)
    assert result.value == pytest.approx(cvxpy.Problem(cvxpy.Minimize(cost), rows).solve("CLARABEL"), rel=1e-6)
    assert result.f == pytest.approx(f.value, abs=1e-4)


@pytest.mark.parametrize("quality", [min_weight_gradient, epsilon_gradient, ball_margin_gradient])
@pytest.mark.parametrize("n", [3, 4, 5])
def test_gradients_of_qualities_by_central_differences(quality, n):
    rng = np.random.default_rng(10 + n)
    tested = 0
    while tested < 4:
        p, normals = ball_grasp(rng, n)
        center = 0.003 * rng.normal(size=3)
        result = quality(p, normals, MU, center, length=RADIUS)
        if not result.value > 1e-3:
            continue
        tested += 1
        dp, dn = 0.01 * rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
        dn -= (dn * normals).sum(axis=1, keepdims=True) * normals
        for moved_p, moved_n in ((dp, 0 * dn), (0 * dp, dn)):
            slope = (result.gradient_p * moved_p).sum() + (result.gradient_n * moved_n).sum()
            h = 1e-3 if quality is ball_margin_gradient else 1e-5
            values = [
                quality(p + s * h * moved_p, normals + s * h * moved_n, MU, center, length=RADIUS).value
                for s in (1.0, -1.0)
            ]
            # A bracket of 1e-6 leaves about its root in the gradient.
            allowed = 5e-3 if quality is ball_margin_gradient else 1e-5
            assert slope == pytest.approx((values[0] - values[1]) / (2 * h), rel=1e-2, abs=allowed)
        assert (result.gradient_n * normals).sum(axis=1) == pytest.approx(0.0, abs=1e-9)


def test_qualities_with_gradients_have_the_values_of_those_without():
    rng = np.random.default_rng(20)
    p, normals = ball_grasp(rng, 4)
    G, options = matrix(p, normals), {"length": RADIUS}
    args = (p, normals, MU, np.zeros(3))
    assert min_weight_gradient(*args, **options).value == min_weight(G, MU, **options)
    assert epsilon_gradient(*args, **options).value == epsilon_linearized(G, MU, **options)
    bracket = ball_margin(G, MU, **options)
    assert bracket.lower - 1e-9 <= ball_margin_gradient(*args, **options).value <= bracket.upper + 1e-9
