# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # In your own diagram
#
# Your robot, your controllers and your cameras live in a Drake diagram of your own. This tutorial puts a hand, an
# object and a table of the library into one, and plays a grasp there: closing, squeezing, lifting. It needs the library
# alone and runs in about ten seconds.

# %%
import numpy as np
from PIL import Image
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

import xdex_drake as xd

# %% [markdown]
# ## A grasp to play
#
# Any grasp will do that has a pre-grasp and a squeeze: one from a file (`xd.load_grasps`), or the first that is found
# here.

# %%
hand, scene = xd.load_hand("allegro"), xd.make_scene(xd.load_object("can"))
grasp = next(g for g in xd.synthesize(hand, scene, count=1) if g.lift.success)
print(grasp)
if xd.can_see():
    Image.fromarray(xd.render_grasp(grasp, hand, scene, size=(640, 480))).save("grasp.png")

# %% [markdown]
# ## Twenty lines of your own
#
# `add_hand`, `add_object` and `add_table` fill a plant that you made. The wrist is welded to whatever carries it, with
# `hand.X_HB` between the flange's frame and the base link; here it rides on three driven slides that stand in for an
# arm. The plant's contact approximation is `lagged`, which transmits coupled joints' forces rightly. `GraspPlayer` is
# an ordinary `LeafSystem` whose outputs are the desired states of joints and slides.

# %%
builder = DiagramBuilder()
config = MultibodyPlantConfig(time_step=0.005, discrete_contact_approximation="lagged")
plant, scene_graph = AddMultibodyPlant(config, builder)
fingers = xd.add_hand(plant, hand, pd_gains=(1.0, 0.1), point_stiffness=1e5)
plant.set_gravity_enabled(fingers, False)
xd.add_carriage(plant, hand, fingers, X_WH=grasp.X_WH)
can = xd.add_object(plant, scene.object, X_WO=scene.X_WO)
xd.add_table(plant, 0.6, [can])
plant.Finalize()
player = builder.AddSystem(xd.GraspPlayer(grasp, hand))
builder.Connect(player.GetOutputPort("joints"), plant.get_desired_state_input_port(fingers))
carriage = plant.GetModelInstanceByName("carriage")
builder.Connect(player.GetOutputPort("wrist"), plant.get_desired_state_input_port(carriage))
simulator = Simulator(builder.Build())
context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
xd.apply_grasp(grasp, hand, plant, context, pregrasp=True)
plant.SetPositions(context, carriage, grasp.X_WH_pregrasp.translation() - grasp.X_WH.translation())
plant.SetFreeBodyPose(context, can, grasp.X_WO)
simulator.AdvanceTo(player.end_s)

# %% [markdown]
# ## What happened
#
# The can rose with the wrist. The library's own lift, which is built from the same pieces, says the same.

# %%
rise = plant.EvalBodyPoseInWorld(context, can).translation()[2] - grasp.X_WO.translation()[2]
print(f"the can rose by {100 * rise:.1f} cm; the library's lift says {100 * grasp.lift.lift_height_m:.1f} cm")
assert abs(rise - grasp.lift.lift_height_m) < 0.01

# %% [markdown]
# An arm that follows poses takes `player.X_WH(t)` instead of the slides:

# %%
for t in (0.0, 0.3, 0.7, player.end_s):
    print(f"{t:.1f} s: wrist at {np.round(player.X_WH(t).translation(), 3)} m")

# %% [markdown]
# **Exercise.** Give the can twice its mass (`xd.load_object("can", mass=0.2)`, in the plant alone) and see whether the
# same squeeze still holds it; then let `start_s=1.0` delay the player and watch the hand wait at its pre-grasp.
