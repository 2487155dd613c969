"""Margins against pushes and their gradients."""

import numpy as np
import pytest

from tests.contact.references import MU, RADIUS, ball_grasp, grasp_map, ring_grasp
from xdex_drake.contact import Effort, gravity_wrench, push_margins, push_wrenches, task_margin

MASS, MOST = 0.3, 6.0


def holding_grasps(n, count):
    """Grasps of a ball that resist every push, to differentiate at."""
    rng = np.random.default_rng(n)
    while count:
        p, normals = ball_grasp(rng, n)
        p = p - 0.003 * rng.normal(size=3)
        if push_margins(p, normals, MU, RADIUS, most_force=MOST).values.min() > 0.05:
            count -= 1
            yield p, normals, rng


@pytest.mark.parametrize("n", [3, 4, 5])
def test_gradients_by_central_differences(n):
    for p, normals, rng in holding_grasps(n, 5):
        found = push_margins(p, normals, MU, RADIUS, most_force=MOST)
        dp, dn = 0.01 * rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
        dn -= (dn * normals).sum(axis=1, keepdims=True) * normals
        h = 1e-4
        for by_p, by_n in ((dp, 0.0 * dn), (0.0 * dp, dn)):
            slopes = (found.by_points * by_p + found.by_normals * by_n).sum(axis=(1, 2))
            there, back = (
                push_margins(p + s * by_p, normals + s * by_n, MU, RADIUS, most_force=MOST).values for s in (h, -h)
            )
            assert slopes == pytest.approx((there - back) / (2.0 * h), rel=5e-3, abs=1e-4)
        assert np.abs((found.by_normals * normals).sum(axis=-1)).max() < 1e-9


@pytest.mark.parametrize("n", [3, 4])
def test_they_are_the_task_margin_with_bounded_normal_forces(n):
    gravity, pushes, weight = gravity_wrench(MASS), push_wrenches(MASS), -gravity_wrench(MASS)[-1]
    for p, normals, _ in holding_grasps(n, 3):
        found = push_margins(p, normals, MU, RADIUS, most_force=MOST)
        bounded = Effort.of_normal_forces(n, MOST * weight)
        margin = task_margin(grasp_map(p, normals), gravity, pushes, effort=bounded)
        assert found.values == pytest.approx(margin.margins, abs=1e-4)


def test_a_grasp_that_does_not_hold_gravity_has_no_margin_and_no_slope():
    p, normals = ring_grasp(3)
    found = push_margins(p, normals, 0.01, RADIUS, most_force=MOST)
    assert not found.values.any() and not found.by_points.any() and not found.by_normals.any()
