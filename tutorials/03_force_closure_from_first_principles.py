# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Force closure from first principles
#
# What does it mean that contacts hold an object? This tutorial builds the answer from friction cones: the grasp matrix,
# the least forces that balance gravity (beside a reference in cvxpy), and the margin that says how much more the grasp
# resists. No hand is needed, only contact points on a ball. Needs cvxpy (`pip install 'xdex_drake[reference]'`) and
# matplotlib.

# %%
import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
from pydrake.solvers import ClarabelSolver
from scipy.spatial import ConvexHull

from xdex_drake.contact import (
    GraspMap,
    balance,
    balance_linearized,
    balance_program,
    ball_margin,
    contact_frames,
    epsilon_linearized,
    grasp_matrix,
    gravity_wrench,
    in_cone,
    push_wrenches,
    support,
    task_margin,
)

MASS, MU, RADIUS = 0.1, 0.6, 0.035

# %% [markdown]
# ## Contacts and their frames
#
# Three contacts on the ball's equator. A contact normal `n_WC` points *into* the object, and the contact frame C has
# its z axis along it. A hard point contact with friction applies a force f = (t1, t2, n) in C, inside the cone
# sqrt(t1^2 + t2^2) <= mu n: it pushes, never pulls.

# %%
angles = np.radians([0.0, 120.0, 240.0])
p_WCs = RADIUS * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])
n_WCs = -p_WCs / RADIUS
R_WCs = contact_frames(n_WCs)
for f in ([0.5, 0.0, 1.0], [0.7, 0.0, 1.0], [0.0, 0.0, -1.0]):
    print(f, "in the cone" if in_cone(np.array(f), MU).all() else "outside the cone")

# %% [markdown]
# ## The grasp matrix
#
# Forces in contact frames become a wrench about the center of mass, torque first: F = G f. Its columns are what unit
# forces do. Normals of a ball all meet in its center, so normal forces cause no torque; friction does.

# %%
G = grasp_matrix(p_WCs, R_WCs, np.zeros(3))
print(np.round(G, 3))

# %% [markdown]
# ## Balance
#
# The least forces that hold the ball against gravity F_g solve a small convex program:
#
#     minimise 1/2 |f|^2   subject to   G f + F_g = 0,   f in the cones
#
# Written in cvxpy, it reads like the formula; `balance` is the library's own, by Clarabel, and much faster. It takes a
# `GraspMap`: the grasp matrix, the friction, and a length of the object that makes torques comparable with forces.

# %%
F_g = gravity_wrench(MASS)
f = cp.Variable(9)
cones = [cp.SOC(MU * f[3 * i + 2], f[3 * i : 3 * i + 2]) for i in range(3)]
cp.Problem(cp.Minimize(0.5 * cp.sum_squares(f)), [G @ f + F_g == 0, *cones]).solve(solver="CLARABEL")
assert f.value is not None
three = GraspMap(G, MU, RADIUS)
ours = balance(three, F_g)
print("cvxpy:", np.round(f.value.reshape(3, 3), 4).tolist())
print("ours: ", np.round(ours.f.reshape(3, 3), 4).tolist(), f"in {1e3 * ours.seconds:.1f} ms")
assert np.allclose(f.value, ours.f, atol=1e-5)

# %% [markdown]
# Each contact lifts a third of the weight by friction, and presses just hard enough for that: n = m g / (3 mu). The
# forces lie on the boundary of their cones, so the slightest push breaks this balance. Squeezing harder costs force but
# leaves a margin.
#
# The same program is at hand as a `MathematicalProgram`, to read and to change. Here the first contact shall press with
# 1 N at least, and the others have to answer. With pyramids of eight edges for cones it is a quadratic program; they
# lie inside the cones, so forces grow a little.

# %%
program = balance_program(three, F_g)
program.AddBoundingBoxConstraint(1.0, np.inf, program.decision_variables()[2])
pressed = ClarabelSolver().Solve(program)
pyramids = balance_linearized(three, F_g, edges=8)
print("normal forces:           ", np.round(ours.f[2::3], 3))
print("the first presses harder:", np.round(pressed.GetSolution(program.decision_variables())[2::3], 3))
print("with pyramids:           ", np.round(pyramids.f[2::3], 3))
assert pressed.is_success() and np.linalg.norm(ours.f) <= np.linalg.norm(pyramids.f)

# %% [markdown]
# ## Margins
#
# The *task margin* is the greatest s such that gravity plus s times each push of m g can still be held. Nothing bounds
# the forces here but friction, so a hand's effort limits are what makes this number finite in practice; the library
# caps it. Two contacts are another matter: they cannot resist a torque about the line between them.

# %%
pushes = push_wrenches(MASS)
print("task margin of three contacts:", task_margin(three, F_g, pushes).margin)
p2 = RADIUS * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
two = GraspMap(grasp_matrix(p2, contact_frames(-p2 / RADIUS), np.zeros(3)), MU, RADIUS)
spin = np.array([[0.1 * MASS * 9.81 * RADIUS, 0, 0, 0, 0, 0]])
print("task margin of a pinch against a spin about its axis:", task_margin(two, F_g, spin).margin)

# %% [markdown]
# The *ball margin* asks for all wrenches at once. With forces whose normal parts sum to one, the wrenches that can be
# made are a convex set W, and the margin is the radius of the greatest ball about 0 inside W (torques divided by a
# length, so that they compare with forces). In direction u, W reaches as far as its support function
#
#     h(u) = max(0, max_i (mu |g_i,t| + g_i,n)),   g = G^T u,
#
# which is closed-form; so directions bound the margin from above, and forces that are known bound it from below.

# %%
u = np.random.default_rng(0).normal(size=(20_000, 6))
reach, _ = support(three, u / np.linalg.norm(u, axis=1, keepdims=True))
ball, pinch = ball_margin(three), ball_margin(two)
print(f"margin of three contacts: {ball.lower:.4f} to {ball.upper:.4f}; least of 20 000 directions: {reach.min():.4f}")
print(f"margin of a pinch: {pinch.lower:.4f} to {pinch.upper:.4f}")
assert ball.upper <= reach.min() + 1e-9 and pinch.upper < 1e-6

# %% [markdown]
# Random directions come near the margin but stay above it: six dimensions are hard to fill. A pinch has margin 0 and
# still lifts things every day, which is why the library's programs ask for the task margin, not for the ball.
#
# ## Ferrari and Canny, seen in three dimensions
#
# Ferrari and Canny (1992) take W as the convex hull of finitely many wrenches, the edges of a pyramid in each friction
# cone; their quality is the distance from 0 to its nearest facet. W has six dimensions, but its slice at zero torque
# has three: the pure forces that the grasp can exert. Along a direction u the hull reaches until the first of its
# facets n . w <= d, which is a ray cast that takes one line.

# %%
edges = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
rays, tilts = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 73), np.linspace(0.0, np.pi, 37))
directions = np.stack([np.cos(rays) * np.sin(tilts), np.sin(rays) * np.sin(tilts), np.cos(tilts)], axis=-1)


def force_slice(mu: float) -> tuple[np.ndarray, float]:
    """Pure forces on the boundary of W in all directions, and the distance from 0 to the nearest facet."""
    cone = np.stack([mu * np.cos(edges), mu * np.sin(edges), np.ones_like(edges)])  # (3, edges)
    wrenches = np.concatenate([(three.scaled[:, 3 * i : 3 * i + 3] @ cone).T for i in range(3)])
    hull = ConvexHull(np.vstack([wrenches, np.zeros(6)]))
    normals, offsets = hull.equations[:, :6], -hull.equations[:, 6]
    speed = directions.reshape(-1, 3) @ normals[:, 3:].T  # no torque: only the force part of a facet's normal counts
    with np.errstate(divide="ignore"):
        reach = np.where(speed > 1e-12, offsets / speed, np.inf).min(axis=1)
    return directions * reach.reshape(rays.shape)[..., None], float(offsets.min())


figure = plt.figure(figsize=(9.0, 4.5))
slices = {}
for k, mu in enumerate((0.2, MU)):
    forces, epsilon = force_slice(mu)
    slices[mu] = np.linalg.norm(forces, axis=-1), epsilon
    axes = figure.add_subplot(1, 2, k + 1, projection="3d")
    axes.plot_surface(*np.moveaxis(forces, -1, 0), alpha=0.35, color="tab:blue", linewidth=0)
    axes.plot_wireframe(*np.moveaxis(epsilon * directions, -1, 0), color="tab:red", linewidth=0.3)
    axes.quiver(*np.zeros((3, 3)), *n_WCs.T, length=0.5, color="black")
    axes.set(title=f"mu = {mu}: nearest facet at {epsilon:.3f}", xlabel="x", ylabel="y", zlabel="z")
    axes.set(xlim=(-0.8, 0.8), ylim=(-0.8, 0.8), zlim=(-0.8, 0.8))
figure.tight_layout()
figure.savefig("wrench_hull.png", dpi=110)
print("written to wrench_hull.png;", {mu: f"quality {epsilon:.4f}" for mu, (_, epsilon) in slices.items()})
print(f"the same by the library: {epsilon_linearized(three, edges=16):.4f}; exact cones {ball.lower:.4f}")

# %% [markdown]
# The blue body holds all forces that the three contacts can exert without a torque, their normal forces summing to one:
# a triangle seen from above, since the contacts lie in a plane, and as thick along z as friction makes it, mu upward
# and downward. The black arrows are the contact normals. The red ball is the quality, and it is smaller than the body:
# the facet that limits it lies in a direction that has torque in it, which a slice of forces cannot show. Pyramids lie
# inside the cones, so their quality is at most the exact margin.

# %%
lengths, epsilon = slices[MU]
assert epsilon <= lengths.min() and slices[0.2][1] < epsilon
assert abs(lengths[0].max() - MU) < 0.02  # straight up: friction alone
assert abs(epsilon - epsilon_linearized(three, edges=16)) < 1e-6 and epsilon <= ball.upper

# %% [markdown]
# **Exercise.** Lower `MU` towards zero. By which law do the forces grow, and does `balance` ever fail? Then allow no
# normal force above 1 N, by the `effort` of `Effort.of_normal_forces(3, 1.0)`: at which `MU` does it fail now?
