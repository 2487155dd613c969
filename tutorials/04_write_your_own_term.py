# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Write your own term
#
# `program.add_cost` takes a plain function and differentiates it numerically. A term that you use often deserves more.
# This tutorial writes one wish in three forms: as an energy term, which one object carries into the batched search and
# into the program; as residuals with their own Jacobian, which the sequential solver turns into a Gauss-Newton model;
# and a hard constraint as a block of rows. It checks all of them against finite differences, and puts them to work.
# Needs *Reading and changing the problem*; runs in less than a minute.

# %%
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

import xdex_drake as xd
from xdex_drake.arrays import skew
from xdex_drake.programs.constraints import Block
from xdex_drake.programs.costs import EnergyCost, LeastSquares
from xdex_drake.programs.point import Point
from xdex_drake.programs.search import SearchSettings, search
from xdex_drake.programs.terms import EQ_1, Pull, View
from xdex_drake.visualization.pictures import contact_sheet

hand = xd.load_hand("allegro")
scene = xd.make_scene(xd.load_object("can"))
program = xd.force_closure_program(hand, scene, seed=0, starts=16)
before = xd.solve(program)
print(program.table(before.point))

# %% [markdown]
# ## The tangent
#
# A `Point` holds a trial configuration of the hand, `point.k`, the contact forces, and what terms read from them. Its
# derivatives are with respect to the *tangent* (w_WH, v_WH, qdot, df): angular velocity of the wrist, velocity of its
# origin, both in W, rates of the actuated joints, change of the forces. There is no quaternion in it, so nothing has to
# be projected; `point.size` is its length and `point.moved(step)` goes along it.
#
# ## An energy term, for the search and for the program
#
# Say the hand shall come in level, as between two shelves: the wrist's z axis, along which the stretched fingers point,
# shall be horizontal. A term is a name, a weight, and `evaluate`, which reads from a `View` what kinematics and
# distances give (rotations and origins of the links, sphere centers with their distances, contact points and normals,
# tips of the fingers), and returns its value with its *pull*: the gradient with respect to just what it has read. It
# needs no Jacobian; the view carries the pull back to wrist and joints. Written with `...` for the leading dimensions,
# it is the same for one point in NumPy and for a batch of candidates in torch.


# %%
@dataclass(frozen=True)
class Level:
    """Squared vertical component of the direction that the stretched fingers point in."""

    weight: float = 50.0
    name: str = "level"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value and gradient: of all entries of R_WH only one counts."""
        z = view.R_WH[..., 2, 2]
        pull = 0.0 * view.R_WH
        pull[..., 2, 2] = 2.0 * z
        return z * z, Pull(R_WH=pull)


# %% [markdown]
# The search takes it beside the terms of Eq. (1), which are a tuple. The weight says what a hand that points straight
# up or down costs beside them; `terms` of the result hold the unweighted value of each.

# %%
mine = Level()
settings = SearchSettings(terms=(*EQ_1, mine))
plain, level_found = (search(hand, scene, count=32, seed=0, settings=s) for s in (SearchSettings(), settings))


def tilt(R_WHs: np.ndarray) -> float:
    """Median angle of the fingers out of the horizontal, in degrees."""
    return float(np.degrees(np.median(np.arcsin(np.abs(R_WHs[:, 2, 2]).clip(max=1.0)))))


tilts = [tilt(found.R_WHs) for found in (plain, level_found)]
print(f"median tilt of the candidates: {tilts[0]:.1f} degrees without the term, {tilts[1]:.1f} with it")
print({name: round(float(np.median(value)), 4) for name, value in level_found.terms.items()})
assert tilts[1] < 0.5 * tilts[0]

# %% [markdown]
# The same object is a cost of a program: `program.add(mine)`. Every solver sees it.

# %%
also = xd.force_closure_program(hand, scene, seed=0, starts=16, search_settings=settings)
also.add(mine)
found_level = xd.solve(also)
print(also.table(found_level.point))
assert "level" in found_level.costs

# %% [markdown]
# ## A cost with its Jacobian
#
# A sum of squares is better known by its residuals: the solver then sees its curvature and takes fewer steps. A
# residual r and the matrix J of its derivatives are all that is needed; the cost is 1/2 weight |r|^2. A direction a
# that is fixed in H moves by w x a, which says how its vertical component changes. (`costs.squared(term, weight)` makes
# such a cost of a term whose value is itself a residual, as hinges are.)

# %%
up = np.array([0.0, 0.0, 1.0])


def level(point: Point) -> tuple[np.ndarray, np.ndarray]:
    """Vertical component of the direction that the stretched fingers point in."""
    a_W = point.k.X_WH.rotation().matrix()[:, 2]
    J = np.zeros((1, point.size))
    J[0, :3] = up @ -skew(a_W)  # da = w x a = -skew(a) w
    return np.array([a_W @ up]), J


leveling = LeastSquares("level", 5.0, level, "fingers out of the horizontal")

# %% [markdown]
# ## A constraint
#
# A `Block` has the same shape, with bounds: lower <= g <= upper. This one keeps the thumb's tip 30 mm above the table,
# in millimetres, because the unit says which tolerance applies. `k.jacobian` gives the Jacobian of points fixed to
# links with respect to the moving part of the tangent; contact forces do not move them, so their columns are zero.

# %%
thumb = next(finger for finger in hand.fingers if finger.name == "thumb")
link, p_LTip = np.array([hand.link_index[thumb.tip_link]]), thumb.p_LTip[None]


def thumb_height(point: Point) -> tuple[np.ndarray, np.ndarray]:
    """Height of the thumb's tip in millimetres."""
    p_WTip = point.k.points(link, p_LTip)
    J = np.zeros((1, point.size))
    J[:, : point.moving] = 1e3 * point.k.jacobian(link, p_WTip)[:, 2]
    return 1e3 * p_WTip[:, 2], J


height_before = thumb_height(before.point)[0][0]
least = height_before + 5.0
high_thumb = Block("thumb", thumb_height, np.array([least]), np.array([np.inf]), "mm", "height of the thumb's tip")
print(f"the thumb's tip is {height_before:.1f} mm above the table, and shall be {least:.1f} mm at least")

# %% [markdown]
# ## Check the derivatives
#
# A wrong sign in a Jacobian rarely fails loudly: the solver takes more steps and stops at a worse point. So compare
# with central differences along every direction of the tangent, at a point off the start, where nothing is zero by
# chance.


# %%
def largest_error(evaluate, point: Point, h: float = 1e-6) -> float:
    """Greatest difference between a Jacobian and central differences."""
    _, J = evaluate(point)
    columns = []
    for direction in np.eye(point.size):
        ahead, behind = evaluate(point.moved(h * direction))[0], evaluate(point.moved(-h * direction))[0]
        columns.append((ahead - behind) / (2.0 * h))
    return float(np.abs(J - np.array(columns).T).max())


rng = np.random.default_rng(0)
somewhere = before.point.moved(0.05 * rng.normal(size=before.point.size))
term_cost = EnergyCost(mine)


def term_rows(point: Point) -> tuple[np.ndarray, np.ndarray]:
    """The energy term as one row."""
    return np.array([term_cost.value(point)]), term_cost.gradient(point)[None]


checked = (("level", level), ("thumb", thumb_height), ("energy term", term_rows))
errors = {name: largest_error(f, somewhere) for name, f in checked}
print("greatest error of the Jacobians:", {name: f"{error:.1e}" for name, error in errors.items()})
assert max(errors.values()) < 1e-5

# %% [markdown]
# And this is what the check says of a Jacobian whose sign is wrong:


# %%
def wrong(point: Point) -> tuple[np.ndarray, np.ndarray]:
    """The cost with a slip in its derivative."""
    r, J = level(point)
    return r, -J


print(f"with the wrong sign: {largest_error(wrong, somewhere):.2f}")
assert largest_error(wrong, somewhere) > 0.1

# %% [markdown]
# ## Into the program
#
# Both are seen by every solver: the sequential one linearises them, Drake's get them by the chain rule on the decision
# variables, quaternion included.

# %%
program.add(leveling)
program.add_constraint(high_thumb)
after = xd.solve(program)
print(program.table(after.point))
tilts = [float(np.degrees(np.arcsin(level(result.point)[0][0]))) for result in (before, after)]
heights = [float(thumb_height(result.point)[0][0]) for result in (before, after)]
print(f"{after.status}; fingers out of the horizontal by {tilts[0]:.1f} degrees before, {tilts[1]:.1f} after")
print(f"thumb's tip at {heights[0]:.1f} mm before, {heights[1]:.1f} mm after")
assert after.success and abs(tilts[1]) < abs(tilts[0]) + 1e-9 and heights[1] > least - 0.2

# %% [markdown]
# The cost has moved the wrist as far as it pays against `posture`, which holds the hand near the start; the constraint
# holds whatever it costs. Had it been impossible, the result would have said so: `infeasible`, and `thumb` by name.
#
# The search knows the wish where its settings hold the term. It finds starts that are level already, from which the
# program has less to do:

# %%
better = xd.force_closure_program(hand, scene, seed=0, starts=16, search_settings=settings)
better.add(leveling)
better.add_constraint(high_thumb)
results = {"plain search": after, "search with the term": xd.solve(better)}
for name, result in results.items():
    degrees = float(np.degrees(np.arcsin(level(result.point)[0][0])))
    print(f"{name}: {result.status}, {degrees:.1f} degrees, level costs {result.costs['level']:.4f}")
assert results["search with the term"].costs["level"] <= after.costs["level"]

# %%
if xd.can_see():
    shown = {"without the term": before, **results}
    grasps = {name: xd.finish_grasp(hand, result.point).grasp for name, result in shown.items()}
    pictures = {name: xd.render_grasp(grasp, hand, scene) for name, grasp in grasps.items() if grasp is not None}
    Image.fromarray(contact_sheet(list(pictures.values()), list(pictures), columns=3)).save("level.png")

# %% [markdown]
# **Exercise.** Keep the index finger's and the middle finger's tips 4 cm apart, as a block of one row in millimetres.
# The gradient of the distance |a - b| with respect to a is the unit vector from b to a: two calls of `k.jacobian` and a
# dot product. Check it, then raise the distance until the program names your constraint.
