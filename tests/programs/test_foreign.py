"""Costs and constraints that a user adds to the `MathematicalProgram` itself count for every solver."""

import subprocess
import sys

import numpy as np
import pytest

from xdex_drake.errors import ConfigError
from xdex_drake.programs.force_closure import program_of_candidate
from xdex_drake.programs.program import tangent_rates, variable_rates
from xdex_drake.programs.solve import SOLVERS, judge, solve


@pytest.fixture
def program(allegro, can_scene, found, solved):
    """A program that has a solution, fresh for each test."""
    return program_of_candidate(allegro, can_scene, found, solved[0])


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_bound_out_of_reach_is_infeasible_by_its_name(program, solver):
    bound = program.prog.AddBoundingBoxConstraint(1.0, 2.0, program.X_WH[2])
    bound.evaluator().set_description("high wrist")
    result = solve(program, solver=solver, time_limit_s=0.5)
    height = result.point.k.X_WH.translation()[2]
    assert not result.success and result.worst
    assert result.violations["high wrist"] == pytest.approx(max(1.0 - height, 0.0), abs=1e-6)
    assert "high wrist" in str(program)


def test_bounds_and_quadratic_rows_within_reach_are_met(program, solved):
    height = solved[1].point.k.X_WH.translation()[2]
    curl = solved[1].point.k.q[5] ** 2 + solved[1].point.k.q[6] ** 2
    program.prog.AddBoundingBoxConstraint(height + 0.004, np.inf, program.X_WH[2])
    program.prog.AddQuadraticConstraint(2.0 * np.eye(2), np.zeros(2), -np.inf, 0.98 * curl, program.q[5:7])
    result = solve(program)
    assert result.success
    assert result.point.k.X_WH.translation()[2] > height + 0.004 - 2e-4
    assert (result.point.k.q[5:7] ** 2).sum() < 0.98 * curl + 2e-4
    # Both have names, and both are judged.
    assert sum("X_WH(2)" in name or "q(5)" in name for name in result.violations) == 2


def test_an_equality_in_plain_python_is_met(program, solved):
    q = solved[1].point.k.q

    def mean(z):
        return np.array([0.5 * (z[0] + z[1])])

    wanted = 0.5 * (q[5] + q[6]) + 0.03
    program.prog.AddConstraint(mean, [wanted], [wanted], program.q[5:7], description="mean flexion")
    result = solve(program)
    assert result.success and result.violations["mean flexion"] < 2e-4
    assert result.point.k.q[5:7].mean() == pytest.approx(wanted, abs=2e-4)


def test_a_quadratic_cost_has_its_effect_and_its_value_is_told(program, solved):
    plain = solved[1].point.k.q[1]
    cost = program.prog.AddQuadraticCost(50.0 * (program.q[1] - plain - 0.1) ** 2)
    cost.evaluator().set_description("open index")
    result = solve(program)
    q = result.point.k.q[1]
    assert result.success and q > plain + 0.02
    assert result.costs["open index"] == pytest.approx(50.0 * (q - plain - 0.1) ** 2)


def test_derivatives_of_foreign_rows_and_costs_agree_with_differences(program):
    w, x, z = program.X_WH[3], program.X_WH[4], program.X_WH[2]
    program.prog.AddConstraint(w * x + z**2 <= 0.1)
    program.prog.AddCost(x**4 + program.q[3] * z)
    program.prog.AddQuadraticCost((x - 1.0) ** 2 + program.q[0] ** 2)
    program.prog.AddL2NormCost(np.eye(3), np.ones(3), program.f[:3])
    terms, rng, h = program.terms(), np.random.default_rng(0), 1e-6
    point = program.start.moved(0.01 * rng.normal(size=program.start.size))
    block, costs = terms.constraints[-1], terms.costs[-3:]
    step = rng.normal(size=point.size)
    ahead, behind = point.moved(h * step), point.moved(-h * step)
    slope = (block.at(ahead)[0] - block.at(behind)[0]) / (2.0 * h)
    assert block.at(point)[1] @ step == pytest.approx(slope, rel=1e-5)
    for cost in costs:
        assert cost.gradient(point) @ step == pytest.approx(
            (cost.value(ahead) - cost.value(behind)) / (2 * h), rel=1e-5
        )
    # The quadratic one's curvature in the joints is Drake's own Hessian.
    quadratic = next(cost for cost in costs if type(cost.binding.evaluator()).__name__ == "QuadraticCost")
    assert quadratic.curvature(point)[6, 6] == pytest.approx(2.0)


def test_rates_of_variables_and_tangent_are_inverse(program):
    x = program.values(program.start)
    assert np.allclose(tangent_rates(x) @ variable_rates(x), np.eye(len(x) - 1), atol=1e-12)


def test_the_program_sees_what_is_added_between_two_solves(program, solved):
    assert solve(program).success
    program.prog.AddBoundingBoxConstraint(1.0, 2.0, program.X_WH[2])
    assert judge(program, solved[1].point)[1] == "BoundingBoxConstraint on X_WH(2)"


def test_the_sequential_solver_refuses_by_name_what_it_cannot_take(program):
    def lost(z):
        return np.array([float(z[0])])

    binding = program.prog.AddConstraint(lost, [0.0], [1.0], program.q[:1], description="lost derivative")
    with pytest.raises(ConfigError, match=r"lost derivative.*AutoDiffXd"):
        solve(program)
    program.prog.RemoveConstraint(binding)
    program.prog.NewContinuousVariables(1, "slack")
    with pytest.raises(ConfigError, match=r"slack\(0\).*snopt"):
        solve(program)


def test_further_variables_are_judged_at_what_the_solver_says(program, solved):
    s = program.prog.NewContinuousVariables(1, "s")
    program.prog.AddLinearConstraint(s[0] == 2.0 * program.q[0]).evaluator().set_description("twice")
    program.prog.SetInitialGuess(program.variables, program.values(solved[1].point))
    program.prog.SetInitialGuess(s, [2.0 * solved[1].point.k.q[0]])
    result = solve(program, solver="snopt")
    assert result.violations["twice"] < 1e-4


def test_every_solver_begins_at_the_initial_guess(program, solved):
    program.prog.SetInitialGuess(program.variables, program.values(solved[1].point))
    result = solve(program, iterations=2, improvement=np.inf)
    assert result.success and result.iterations <= 2
    assert np.allclose(result.point.k.q, solved[1].point.k.q, atol=0.02)


FUNCTION_OF_A_SCRIPT = """
import xdex_drake as xd
scene = xd.make_scene(xd.load_object("can"))
program = xd.force_closure_program(xd.load_hand("allegro"), scene, starts=2)
program.add_cost("upright", lambda k: 1.0 - k.X_WH.rotation().matrix()[2, 2], weight=0.1)
program.prog.AddCost(lambda z: z[0], program.q[:1])
print(xd.solve(program).status)
"""


def test_a_script_whose_functions_drake_keeps_ends_in_silence():
    done = subprocess.run(
        [sys.executable, "-c", FUNCTION_OF_A_SCRIPT], capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout.strip() in ("solved", "infeasible") and done.stderr == ""
