# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Reading and changing the problem
#
# A grasp program is open: it can be printed term by term, and it takes costs and constraints of your own. This tutorial
# adds one cost through `program.add_cost`, one of the library's through `program.add`, one through Drake's own
# `AddCost`, and looks at what each does to the grasp.
# Needs *A first grasp*; runs in less than a minute.

# %%
import numpy as np
from PIL import Image

import xdex_drake as xd
from xdex_drake.programs.margin_cost import margin_cost
from xdex_drake.visualization.pictures import contact_sheet

hand = xd.load_hand("allegro")
scene = xd.make_scene(xd.load_object("can"))


def build() -> xd.GraspProgram:
    """The same program each time: the same seed gives the same start."""
    return xd.force_closure_program(hand, scene, seed=0, starts=16)


plain = build()
before = xd.solve(plain)
print(plain.table(before.point))

# %% [markdown]
# ## What the table says
#
# A *cost* is 1/2 w |r|^2 of a residual r with a known Jacobian; `posture` holds the hand near its start, `effort` keeps
# contact forces small. A *constraint* is a block of rows with bounds: millimetres for distances, multiples of the
# object's weight for forces. The decision variables are the wrist pose (position and quaternion), the actuated joints,
# and one force a contact:

# %%
print("X_WH", plain.X_WH.shape, " q", plain.q.shape, " f", plain.f.shape)
print("costs:", [cost.name for cost in plain.costs])
print("constraints:", [block.name for block in plain.constraints])

# %% [markdown]
# ## A cost in one line
#
# The function receives the hand's configuration `k`: `k.X_WH`, `k.q`, and points of any link. This one asks for a lower
# wrist, in metres above the table. Write smooth functions: a solver follows gradients, and at a kink there is none.

# %%
lower = build()
lower.add_cost("low wrist", lambda k: k.X_WH.translation()[2] ** 2, weight=20.0)
after = xd.solve(lower)
heights = [100 * result.point.k.X_WH.translation()[2] for result in (before, after)]
print(f"height of the wrist: {heights[0]:.2f} cm before, {heights[1]:.2f} cm after; {after.status}")
print("cost by term:", {name: round(value, 4) for name, value in after.costs.items()})

# %% [markdown]
# The grasp still meets every constraint: a cost bargains with other costs, never with a constraint. But a weight that
# is too great drives the hand far from its start, and with it from the neighbourhood where a good grasp is found: raise
# weights step by step.
#
# ## A cost that makes the grasp firmer
#
# Holding the object is a constraint, and nothing so far asks for more. `margin_cost` does: for a push along each axis
# it takes the greatest multiple of the object's weight that the contacts resist beside gravity, a convex program each,
# whose multipliers say how the margin changes as contacts move. It needs a grasp that holds gravity to have a slope, so
# the program starts where the first one ended.

# %%
k = before.point.k
touching = np.isin(np.arange(len(hand.fingers)), before.point.contacts.fingers)
firm = xd.polish_program(hand, scene, k.X_WH, k.q, touching)
firm.add(margin_cost())
proofs = [xd.finish_grasp(hand, point).grasp for point in (before.point, xd.solve(firm).point)]
margins = [grasp.certificate.task_margin for grasp in proofs if grasp is not None and grasp.certificate is not None]
print("certified task margin: {:.2f} before, {:.2f} after".format(*margins))

# %% [markdown]
# Below 1, a push as strong as the object is heavy throws it off; a search of the library hands out no such grasp.
# What the costs did to the hand:

# %%
lowered = xd.finish_grasp(hand, after.point).grasp
shown = {"plain": proofs[0], "low wrist": lowered, "firm": proofs[1]}
if xd.can_see():
    pictures = {what: xd.render_grasp(grasp, hand, scene) for what, grasp in shown.items() if grasp is not None}
    Image.fromarray(contact_sheet(list(pictures.values()), list(pictures), columns=3)).save("three_programs.png")

# %% [markdown]
# ## A cost through Drake
#
# `program.prog` is an ordinary `MathematicalProgram`, and anything that Drake offers can be added to it. Such a cost is
# seen by Drake's solvers, here NLopt, but not by our sequential solver, which needs terms that it knows by name.

# %%
straight = build()
index = [k for k, name in enumerate(hand.joint_names) if name in ("joint_0.0", "joint_4.0", "joint_8.0")]
spread = straight.q[index]
straight.prog.AddQuadraticCost(10.0 * np.eye(3), np.zeros(3), spread).evaluator().set_description("no spread")
results = {"without": xd.solve(build(), solver="nlopt"), "with": xd.solve(straight, solver="nlopt")}
for label, result in results.items():
    angles = np.degrees(result.point.k.q[index])
    print(f"{label:<8}{result.status}; spread of index, middle and ring {np.round(angles, 1)} degrees")

# %% [markdown]
# ## A constraint that cannot be met
#
# The same program on a can without friction is infeasible, since upright walls cannot be held by forces along their
# normals. The result names the constraint that stays violated, and by how much: this is the first thing to read when a
# problem of your own does not solve.

# %%
slippery = xd.make_scene(xd.load_object("can", friction=0.02))
failed = xd.solve(xd.force_closure_program(hand, slippery, contacts=2, starts=16))
print(failed.status, "by", failed.worst, {name: f"{v:.2g}" for name, v in failed.violations.items() if v > 1e-3})

# %%
assert before.success and after.success and not failed.success
assert heights[1] < heights[0] and margins[0] < margins[1]
spreads = {label: np.abs(result.point.k.q[index]).sum() for label, result in results.items()}
assert results["with"].success and spreads["with"] < spreads["without"]

# %% [markdown]
# **Exercise.** Let the palm face the object: `k.X_WH.rotation().matrix()[:, 0]` is the wrist's x axis in W, and points
# out of the palm. Write the cost 1 - cos of its angle to the direction of the center of mass, and watch `posture` rise.
