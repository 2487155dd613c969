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
# resists. No hand is needed, only contact points on a ball. Needs cvxpy (`pip install 'xdex_drake[reference]'`).

# %%
import cvxpy as cp
import numpy as np

from xdex_drake.contact import (
    balance,
    ball_margin,
    contact_frames,
    grasp_matrix,
    gravity_wrench,
    in_cone,
    support,
    task_margin,
)
from xdex_drake.contact.wrench import push_wrenches

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
# Written in cvxpy, it reads like the formula; `balance` is the library's own, by Clarabel, and much faster.

# %%
F_g = gravity_wrench(MASS)
f = cp.Variable(9)
cones = [cp.SOC(MU * f[3 * i + 2], f[3 * i : 3 * i + 2]) for i in range(3)]
cp.Problem(cp.Minimize(0.5 * cp.sum_squares(f)), [G @ f + F_g == 0, *cones]).solve(solver="CLARABEL")
assert f.value is not None
ours = balance(G, MU, F_g, length=RADIUS)
print("cvxpy:", np.round(f.value.reshape(3, 3), 4).tolist())
print("ours: ", np.round(ours.f.reshape(3, 3), 4).tolist(), f"in {1e3 * ours.seconds:.1f} ms")
assert np.allclose(f.value, ours.f, atol=1e-5)

# %% [markdown]
# Each contact lifts a third of the weight by friction, and presses just hard enough for that: n = m g / (3 mu). The
# forces lie on the boundary of their cones, so the slightest push breaks this balance. Squeezing harder costs force but
# leaves a margin.
#
# ## Margins
#
# The *task margin* is the greatest s such that gravity plus s times each push of m g can still be held. Nothing bounds
# the forces here but friction, so a hand's effort limits are what makes this number finite in practice; the library
# caps it. Two contacts are another matter: they cannot resist a torque about the line between them.

# %%
pushes = push_wrenches(MASS)
print("task margin of three contacts:", task_margin(G, MU, F_g, pushes, length=RADIUS).margin)
two = [0.0, np.pi]
p2 = RADIUS * np.column_stack([np.cos(two), np.sin(two), np.zeros(2)])
G2 = grasp_matrix(p2, contact_frames(-p2 / RADIUS), np.zeros(3))
spin = np.array([[0.1 * MASS * 9.81 * RADIUS, 0, 0, 0, 0, 0]])
print("task margin of a pinch against a spin about its axis:", task_margin(G2, MU, F_g, spin, length=RADIUS).margin)

# %% [markdown]
# The *ball margin* asks for all wrenches at once. With forces whose normal parts sum to one, the wrenches that can be
# made are a convex set W, and the margin is the radius of the greatest ball about 0 inside W (torques divided by a
# length, so that they compare with forces). In direction u, W reaches as far as its support function
#
#     h(u) = max(0, max_i (mu |g_i,t| + g_i,n)),   g = G^T u,
#
# which is closed-form; so directions bound the margin from above, and forces that are known bound it from below.

# %%
scaled = G / np.array([RADIUS] * 3 + [1.0] * 3)[:, None]
u = np.random.default_rng(0).normal(size=(20_000, 6))
reach, _ = support(scaled, MU, u / np.linalg.norm(u, axis=1, keepdims=True))
ball, pinch = ball_margin(G, MU, length=RADIUS), ball_margin(G2, MU, length=RADIUS)
print(f"margin of three contacts: {ball.lower:.4f} to {ball.upper:.4f}; least of 20 000 directions: {reach.min():.4f}")
print(f"margin of a pinch: {pinch.lower:.4f} to {pinch.upper:.4f}")
assert ball.upper <= reach.min() + 1e-9 and pinch.upper < 1e-6

# %% [markdown]
# Random directions come near the margin but stay above it: six dimensions are hard to fill. A pinch has margin 0 and
# still lifts things every day, which is why the library's programs ask for the task margin, not for the ball.
#
# **Exercise.** Lower `MU` towards zero. By which law do the forces grow, and does `balance` ever fail? Then allow no
# normal force above 1 N, by the map `A` that picks the normals and an `effort` of 1 N: at which `MU` does it fail now?
