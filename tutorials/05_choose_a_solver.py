# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Choose a solver
#
# A grasp program is an ordinary `MathematicalProgram`, so SNOPT, IPOPT and NLopt can solve it as they are; the library
# adds a sequential convex solver of its own. Which one should you take? This tutorial runs the same programs with all
# four and draws their performance profiles. Needs *Reading and changing the problem*; runs in less than a minute.

# %%
from pathlib import Path

import xdex_drake as xd
from xdex_drake.bench.problems import bench_problems, profile_picture, profile_ratios, summary
from xdex_drake.bench.watch import Watch

hand = xd.load_hand("allegro")
scene = xd.make_scene(xd.load_object("can"))


def build() -> xd.GraspProgram:
    """The same program each time, so that no solver starts from what another has computed."""
    return xd.force_closure_program(hand, scene, seed=0, starts=16)


# %% [markdown]
# ## One program, four solvers
#
# `solve` returns a result whatever happens. Its status is judged by the library's own residuals, never by what the
# solver says of itself: a solver that stops at its iteration limit may hold a fine grasp, and one that reports success
# may have another idea of small. Drake's solvers are stopped after `time_limit_s`.

# %%
print(f"{'solver':<12}{'status':<12}{'time':>9}  {'cost':>7}  worst constraint")
results = {}
for solver in ("sequential", "snopt", "ipopt", "nlopt"):
    result = results[solver] = xd.solve(build(), solver=solver, time_limit_s=3.0)
    cost = sum(result.costs.values())
    print(f"{solver:<12}{result.status:<12}{1e3 * result.seconds:>6.0f} ms  {cost:>7.4f}  {result.worst or '-'}")
assert results["sequential"].success and results["sequential"].seconds < 1.0

# %% [markdown]
# ## Why they differ
#
# *The sequential solver* knows the terms by name. It linearises distances, keeps friction cones as pyramids inside the
# exact ones, gives every group of inequalities one slack, and solves a small quadratic program (DAQP) in a trust
# region. Costs that are squares are squares in the model, too, so it needs no second derivatives and no quasi-Newton
# update. A subproblem takes a few milliseconds, most of it distances and Jacobians, and ten of them usually do.
#
# *SNOPT and NLopt's SLSQP* learn the curvature from gradients, which takes a hundred evaluations and more. Exact
# distances to a mesh have kinks, where the nearest facet changes; line searches are lost there, which is what SNOPT
# reports as "the current point cannot be improved". SLSQP is more patient and often ends a little lower.
#
# *IPOPT* stays inside the constraints by a barrier and wants second derivatives; with limited memory instead, and
# kinks, it rarely gets there in time.
#
# ## Performance profiles
#
# One program proves nothing. The library's problems have the same form from easy to infeasible; `xdex bench problems`
# runs them all by every solver. Here are five of them, two seconds a solve. The *profile* of a solver (Dolan and More
# 2002) at tau is the share of problems that it solved within tau times the time of the fastest: at tau = 1 it tells how
# often the solver is the fastest, far to the right how often it solves at all.

# %%
watch = Watch()
names = ("allegro_can", "ability_box", "shadow_bottle", "generated_hand_can", "allegro_flat_brick")
bench_problems(watch, names, starts=1, time_limit_s=2.0, tick=lambda: None)
for run in watch.runs:
    told = f"{1e3 * run['seconds']:.0f} ms" if run["solved"] else f"left {run['worst']} violated"
    print(f"{run['problem']:<22}{run['solver']:<12}{told}")

# %%
rows = summary(watch.runs)
for solver, row in rows.items():
    print(f"{solver:<12}" + ", ".join(f"{label} {value:g}" for label, value in row.items()))
Path("profiles.svg").write_text(profile_picture("five problems, two seconds a solve", watch.runs))
print("written to profiles.svg: open it in a browser")

# %% [markdown]
# The flat brick is infeasible on purpose. It counts for no profile, but look at its rows: a solver that says *which*
# constraint is left, and soon, saves the time of searching on. The picture of all problems is in
# `studies/bench/problems_profile.svg`.

# %%
assert len(profile_ratios(watch.runs)["sequential"]) == 4
assert not any(run["solved"] for run in watch.runs if run["problem"] == "allegro_flat_brick")
assert rows["sequential"]["solved"] == max(row["solved"] for row in rows.values())

# %% [markdown]
# ## Which one, then?
#
# Take the default, `sequential`, for programs made of the library's terms and of your own written as in *Write your own
# term*. Take `nlopt` when you added costs through Drake's own `AddCost`, which the sequential solver does not see, or
# to ask whether a cost can still be lowered. `snopt` and `ipopt` are there for programs of yours that suit them.
#
# **Exercise.** Solve the can once more with `solver="nlopt"`, starting from the sequential solver's point: put it in
# place with `program.prog.SetInitialGuess(program.variables, program.values(result.point))`. How much lower does the
# cost get, in which time, and does the grasp look any different?
