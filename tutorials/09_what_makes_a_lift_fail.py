# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # What makes a lift fail
#
# A success rate means little without the conditions: friction, mass, how the squeeze is chosen, how exact the pose is.
# This tutorial takes one certified grasp and changes one condition after the other until the lift fails, reads the
# reasons, and compares them with what the certificate promised. It needs the library alone, runs in less than a minute,
# and writes `failed_lift.html` into the working folder.

# %%
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from pydrake.math import RigidTransform

import xdex_drake as xd

hand = xd.load_hand("allegro")
scene = xd.make_scene(xd.load_object("can"), seed=0)
grasps = xd.synthesize(hand, scene, count=1, seed=0, time_limit_s=30.0)
grasp = next(grasp for grasp in grasps if grasp.lift is not None and grasp.lift.success)
certificate = grasp.certificate
assert certificate is not None
print("protocol", xd.LIFT.name, "| contacts:", [contact.link for contact in certificate.contacts])
forces = np.array([contact.f_C[2] for contact in certificate.contacts])
print("promised normal forces [N]:", np.round(forces, 2), "for a weight of", round(9.81 * scene.object.mass, 2), "N")


# %%
def tell(what: str, verdict: xd.Lift) -> None:
    said = "lifts" if verdict.success else verdict.failure_reason
    print(f"{what:<28} {said:<20} rose {100.0 * verdict.lift_height_m:5.1f} cm, tips {', '.join(verdict.fingertips)}")


# %% [markdown]
# ## Friction
#
# The certificate's forces lie within cones narrower than the stated friction of 0.6, so there is something in reserve.
# When it is used up, the can stays on the table. Friction belongs to both surfaces: the object's is in its model, the
# hand's in the protocol's plant.

# %%
for mu in (0.6, 0.45, 0.3, 0.2, 0.1):
    protocol = replace(xd.LIFT, plant=replace(xd.LIFT.plant, friction=mu))
    slippery = xd.with_physics(scene, mass=scene.object.mass, friction=mu)
    tell(f"friction {mu}", xd.lift(grasp, hand, slippery, protocol=protocol))

# %% [markdown]
# ## Mass
#
# The squeeze does not know that the object became heavier: joint targets apply the same torques. With a pinch of normal
# forces N the load ends at 2 mu N, whatever the simulator; more contacts carry more.

# %%
for mass in (0.1, 0.2, 0.4, 0.8):
    heavy = xd.with_physics(scene, mass=mass, friction=scene.object.friction)
    tell(f"mass {1e3 * mass:.0f} g", xd.lift(grasp, hand, heavy))
print(f"bound by friction alone: {1e3 * scene.object.friction * forces.sum() / 9.81:.0f} g")

# %% [markdown]
# ## Squeeze
#
# The squeeze drives the joints by the torques of the promised forces. Without them the fingers rest at the surface,
# where a touch without force holds nothing.

# %%
assert grasp.tau_squeeze is not None and grasp.X_WH_pregrasp is not None and grasp.q_pregrasp is not None
for share in (1.0, 0.7, 0.4, 0.2, 0.0):
    weak = replace(grasp, tau_squeeze=share * grasp.tau_squeeze)
    tell(f"squeeze {share:.0%}", xd.lift(weak, hand, scene))

# %% [markdown]
# ## Pose
#
# A wrist that is somewhere else than it believes: the hand pushes the can, misses it, starts in it or in the table. The
# pre-grasp keeps 5 mm of clearance, so an error of 1 cm may already start in contact. The reason that is named is the
# first that matches, in the order in which things go wrong.

# %%
for axis, name in enumerate("xyz"):
    for offset in (-0.06, -0.01, 0.01, 0.06):
        shift = RigidTransform(offset * np.eye(3)[axis])
        moved = replace(grasp, X_WH=shift @ grasp.X_WH, X_WH_pregrasp=shift @ grasp.X_WH_pregrasp)
        tell(f"wrist {1e3 * offset:+.0f} mm along {name}", xd.lift(moved, hand, scene))

# %% [markdown]
# ## Robust or lucky?
#
# One lift under exact conditions is the weakest of claims. A *robust* lift repeats it under errors of the wrist's pose
# (up to 5 mm and 5 degrees), with 0.75 times the friction, and with twice the mass, and succeeds where each of them
# does. `xdex lift grasps.parquet --robust 5` does so for a file of grasps.

# %%
robust = xd.robust_lift(grasp, hand, scene)
tell("robust", robust.lift)
print(f"share of the repeats that lift: {robust.share:.0%}")
tell("less friction", robust.slippery)
tell("twice the mass", robust.heavy)

# %% [markdown]
# ## Look at a failure
#
# Any lift replays as a page of its own, failed ones with the reason, the contact forces as arrows. Most failures are
# understood at a glance.

# %%
failed = replace(grasp, tau_squeeze=0.2 * grasp.tau_squeeze)
Path("failed_lift.html").write_text(xd.replay_lift(failed, hand, scene))
if xd.can_see():
    Image.fromarray(xd.render_grasp(grasp, hand, scene, size=(640, 480))).save("failed_lift.png")
print("failed_lift.html:", Path("failed_lift.html").stat().st_size // 1000, "kB")

# %% [markdown]
# Other protocols ask other things: `xd.find_protocol("bench-lift")` bounds how far the object turns in the hand, and
# `frogger-lift` shakes it.
#
# **Exercise.** Find by bisection the least friction at which this grasp lifts, and compare it with the least at which
# the certificate can still be given (`xd.certify` with a smaller friction of its `HeldObject`). Which of the two is
# smaller, and why may it be?
