# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # A first grasp
#
# Shows the whole way from a hand and an object to a grasp that is optimised, proved and lifted, and then the same grasp
# by another hand. Needs the library alone; runs in less than a minute. It writes two pages, `allegro.html` and
# `shadow.html`, into the working folder.
#
# The verbs are always the same: one *builds* a problem, one *solves* it, one *judges* the solution.

# %%
from pathlib import Path

from PIL import Image

import xdex_drake as xd

print("hands:  ", ", ".join(xd.list_hands()))
print("objects:", ", ".join(xd.list_objects()))

# %% [markdown]
# ## Hand, object, scene
#
# A scene is an object that rests on the table, whose top is z = 0 of the world W. `X_WO` is the pose of the object O in
# W: names carry their frames. `seed=0` takes the most probable way to rest; another seed draws another one.

# %%
hand = xd.load_hand("allegro")
scene = xd.make_scene(xd.load_object("can"), seed=0)
print(f"{hand.display_name}: {len(hand.joint_names)} actuated joints, fingers {[f.name for f in hand.fingers]}")
print("the can's center of mass in W:", scene.X_WO @ scene.object.p_OOcm)

# %% [markdown]
# ## Build
#
# `force_closure_program` searches from 16 random starts at once, and turns the best candidate into a
# `MathematicalProgram` whose costs and constraints have names. Printing it shows them at the initial guess: fingertips
# are about a millimetre from the surface, and no force holds the object yet.

# %%
program = xd.force_closure_program(hand, scene, contacts=4, seed=0, starts=16)
print(program)

# %% [markdown]
# ## Solve
#
# `solve` never raises because there is no grasp: a solve that fails is a result, which names the constraint that could
# not be met. Whether it succeeded is judged by our own residuals, not by the solver's word.

# %%
result = xd.solve(program)
print(result)
assert result.success, f"{result.worst} could not be met: try another seed"

# %% [markdown]
# ## Judge
#
# The point is finished to a grasp: a convex program finds contact forces in exact friction cones, and they become a
# *certificate*. `check_certificate` needs no solver, only matrix products: anyone can repeat it. The task margin says
# how many times its own weight the object may be pushed in any of six directions; the ball margin is the radius of the
# ball of wrenches that the grasp resists, bracketed from both sides.

# %%
grasp = xd.finish_grasp(hand, result.point).grasp
assert grasp is not None and grasp.certificate is not None
proof = grasp.certificate
for contact in proof.contacts:
    print(f"{contact.link:<12} normal force {contact.f_C[2]:.2f} N")
print(f"task margin {proof.task_margin:.2f}, ball margin {proof.margin_lower:.4f} to {proof.margin_upper:.4f}")
print("holds in plain NumPy:", xd.check_certificate(proof).passes())

# %% [markdown]
# The last judge is a simulation. The hand starts clear of the object, closes, squeezes with the certificate's forces,
# and rises by 25 cm; the object must follow by 20 cm and be touched by two fingertips at the end.

# %%
lift = xd.lift(grasp, hand, scene)
print("lifted:", lift.success, lift.failure_reason, f"by {100 * lift.lift_height_m:.1f} cm, held by", lift.fingertips)
Path("allegro.html").write_text(xd.replay_lift(grasp, hand, scene))
if xd.can_see():  # a still picture, where this machine can render
    Image.fromarray(xd.render_grasp(grasp, hand, scene, size=(640, 480))).save("allegro.png")

# %% [markdown]
# ## The same grasp by another hand
#
# Retargeting asks the other hand's fingertips and wrist to be where this hand's are, finger by finger through their
# names, under the same hard constraints. It can fail, and says why: not every hand can hold everything in every way.

# %%
shadow = xd.load_hand("shadow")
outcome = xd.retarget(grasp, hand, shadow, scene)
print("by Shadow:", "found" if outcome.grasp else f"none, {outcome.reason} could not be met")
if outcome.grasp is not None:
    print("lifted:", xd.lift(outcome.grasp, shadow, scene).success)
    Path("shadow.html").write_text(xd.replay_lift(outcome.grasp, shadow, scene))
    if xd.can_see():
        Image.fromarray(xd.render_grasp(outcome.grasp, shadow, scene, size=(640, 480))).save("shadow.png")

# %% [markdown]
# Open the pages in a browser: they need no network.
#
# **Exercise.** Take `"mug"` and seeds 0 to 4. Which constraint stops the seeds that fail? `result.violations` knows.
