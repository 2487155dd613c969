# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # In MuJoCo
#
# A grasp that was made here is played elsewhere: MuJoCo opens a folder that this tutorial writes, without this library,
# and lifts the object by the scene's key frames. Then the same protocol is asked of both simulators, and the numbers
# that a real robot would be sent are read. It needs `pip install 'xdex_drake[mujoco]'`, runs in less than a minute, and
# writes the folder `scenes`.

# %%
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

import xdex_drake as xd
from xdex_drake.simulation import mujoco as judge_in_mujoco

hand = xd.load_hand("allegro")
scene = xd.make_scene(xd.load_object("can"), seed=0)
grasps = xd.synthesize(hand, scene, count=1, seed=0, time_limit_s=60.0)
grasp = next(grasp for grasp in grasps if grasp.lift is not None and grasp.lift.success)

# %% [markdown]
# ## A scene that runs as it is
#
# The hand hangs on three slides, driven as in our lifts; the object collides by its convex parts; gains, friction and
# contacts are set in the file. `xdex export grasps.parquet --format mujoco --out scenes` writes the same for a whole
# file of grasps, and `python -m mujoco.viewer --mjcf=scenes/FILE.xml` shows it.

# %%
(file,) = xd.export_scenes([(grasp, hand, scene)], "scenes")
model = mujoco.MjModel.from_xml_path(str(file))
print(file.name, "|", model.nbody, "bodies,", model.nu, "actuators,", model.opt.timestep, "s a step")
print("key frames:", [model.key(k).name for k in range(model.nkey)])
if xd.can_see():
    Image.fromarray(xd.render_grasp(grasp, hand, scene, size=(640, 480))).save("scene.png")

# %% [markdown]
# ## Play it, by MuJoCo alone
#
# A key frame holds postures and what the actuators are to be sent. From one to the next the controls go in a straight
# line; the lift itself is the third slide.


# %%
def play(model: mujoco.MjModel, rise_m: float = 0.25) -> float:
    """How far the object comes up [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("pregrasp").id)
    start = float(data.qpos[-5])
    stages = [model.key(name).ctrl.copy() for name in ("pregrasp", "grasp", "squeeze", "squeeze")]
    stages[-1][2] += rise_m
    for begin, end, seconds in zip(stages, stages[1:], (1.0, 0.4, 0.7), strict=False):
        for s in np.linspace(0.0, 1.0, round(seconds / model.opt.timestep)):
            data.ctrl[:] = begin + s * (end - begin)
            mujoco.mj_step(model, data)
    return float(data.qpos[-5]) - start


print(f"the can comes up by {100.0 * play(model):.1f} cm")

# %% [markdown]
# ## Change the physics
#
# It is MuJoCo's model now. Contacts of the object have its priority, so that friction is a number of its geometries.

# %%
slippery = mujoco.MjModel.from_xml_path(str(file))
of_object = slippery.geom_bodyid == slippery.body("object").id
for mu in (0.6, 0.1, 0.02):
    slippery.geom_friction[of_object, 0] = mu
    print(f"friction {mu}: {100.0 * play(slippery):5.1f} cm")

# %% [markdown]
# ## A second judge
#
# The same protocol, with the same rule, in both simulators: pushes included, and without a table.
# `xdex lift grasps.parquet --protocol hold --simulator drake --simulator mujoco` does it for a file.

# %%
for name in ("lift-0.2/2tips", "hold", "bench-fc"):
    protocol = xd.find_protocol(name)
    verdicts = [judge(grasp, hand, scene, protocol=protocol) for judge in (xd.lift, judge_in_mujoco.lift)]
    for v in verdicts:
        reason = v.failure_reason or (v.hold.reason if v.hold is not None else "")
        print(f"{v.protocol:<24} {'passed' if v.passed else reason}")

# %% [markdown]
# ## For a robot
#
# What an arm and a hand are sent is the same in any simulator: poses of the hand's base link, joint positions, torques
# beside them, gains and times. `xdex export grasps.parquet` writes it as JSON.

# %%
package = xd.execution_package(grasp, hand, scene)
print(package["hand"]["base_link"], "| kp", package["hand"]["kp"], "kd", package["hand"]["kd"])
for waypoint in package["waypoints"]:
    torque = np.abs(waypoint["torque"]).max()
    print(f"{waypoint['time_s']:5.2f} s  {waypoint['name']:<9} base at {np.round(waypoint['X_WB'][:3], 3)}", end="  ")
    print(f"torques up to {torque:.2f} N m")
print(len(list(Path("scenes").rglob("*.obj"))), "meshes beside", file.name)

# %% [markdown]
# **Exercise.** Write a policy for the fingers instead of the constant squeeze: read contact forces by
# `mujoco.mj_contactForce` while the hand rises, and let a finger press harder where its contact nears the friction
# cone. How much heavier may the can be before it slips?
