# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Bring your own hand
#
# A robot file of your own becomes a hand with one call: nothing is annotated by you. This tutorial writes a small URDF,
# imports it, reads what was decided, corrects one thing, and grasps with it. It needs the library alone, runs in about
# a minute, and writes `three_fingers.urdf`, `three_fingers.html` and `grasp.html` into the working folder.

# %%
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import xdex_drake as xd

# %% [markdown]
# ## A hand that the library has never seen
#
# Three fingers of two joints stand around a round palm, 120 degrees apart. As in many files, there are no inertias, the
# efforts are placeholders, and nothing says which link is the palm, where the fingertips are or which way fingers
# close.

# %%
FINGER = """
  <joint name="j{k}a" type="revolute"><parent link="plate"/><child link="f{k}a"/>
    <origin xyz="{x} {y} 0.02" rpy="0 0 {turn}"/><axis xyz="0 -1 0"/>
    <limit lower="-0.6" upper="1.2" effort="1000" velocity="1"/></joint>
  <link name="f{k}a"><collision><origin xyz="0 0 0.03"/>
    <geometry><cylinder radius="0.011" length="0.06"/></geometry></collision></link>
  <joint name="j{k}b" type="revolute"><parent link="f{k}a"/><child link="f{k}b"/>
    <origin xyz="0 0 0.062"/><axis xyz="0 -1 0"/>
    <limit lower="-0.3" upper="1.4" effort="1000" velocity="1"/></joint>
  <link name="f{k}b"><collision><origin xyz="0 0 0.022"/>
    <geometry><cylinder radius="0.011" length="0.05"/></geometry></collision></link>"""


def urdf() -> str:
    fingers = ""
    for k, angle in enumerate(np.deg2rad([0.0, 120.0, 240.0])):
        fingers += FINGER.format(k=k, x=0.045 * np.cos(angle), y=0.045 * np.sin(angle), turn=angle)
    palm = '<collision><geometry><cylinder radius="0.055" length="0.03"/></geometry></collision>'
    return f'<robot name="three_fingers"><link name="plate">{palm}</link>{fingers}</robot>'


Path("three_fingers.urdf").write_text(urdf())

# %% [markdown]
# ## Import
#
# The result holds the hand and every decision, each a sentence to check: *decided* where there was a choice, *mended*
# where the file was wrong or silent, *warning* where you should look. On the command line, `xdex hand import
# three_fingers.urdf --html three_fingers.html` prints the same and writes the page.

# %%
imported = xd.import_hand("three_fingers.urdf")
hand = imported.hand
for decision in imported.decisions:
    print(decision)
print("palm:", hand.links[0].name, "| fingers:", {finger.name: finger.tip_link for finger in hand.fingers})

# %% [markdown]
# The wrist frame H is the same for every hand: +z towards the fingers, +x out of the palm, and for a right hand the
# index finger on the +y side. That is what makes grasps of different hands comparable. The page shows H, the fingertips
# and their pads, and moves every joint.

# %%
Path("three_fingers.html").write_text(xd.import_page(imported))
print("palm link in H:", hand.p_HB, "rest posture [rad]:", np.round(hand.q_rest, 2))
if xd.can_see():
    Image.fromarray(xd.hands_sheet([hand], size=(480, 480))).save("three_fingers.png")

# %% [markdown]
# ## Correct what is wrong
#
# Nothing in a file tells how strong the real motors are. Efforts limit the forces that a certificate may use, so they
# are worth a look into the data sheet. A hand is plain data: change it here, or in the YAML file that `xdex hand import
# --out` writes.

# %%
print("efforts by the importer's rule [N m]:", hand.effort)
hand = replace(hand, joints=tuple(replace(joint, effort=0.8) for joint in hand.joints))

# %% [markdown]
# A fingertip of your own replaces the one of the file; spheres, inertia and tip point follow. `geometry` may also be
# the path of a mesh.

# %%
for finger in hand.fingers:
    pad = xd.Capsule(np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.042]), 0.013)
    hand = xd.replace_tip(hand, finger.name, [pad])
print("tips:", [np.round(finger.p_LTip, 4).tolist() for finger in hand.fingers])

# %% [markdown]
# ## Grasp
#
# Nothing more is needed. Grasps come certified and with the verdict of a lift.

# %%
scene = xd.make_scene(xd.load_object("ball"), seed=0)
grasps = list(xd.synthesize(hand, scene, count=2, seed=0, time_limit_s=60.0))
lifted = [grasp for grasp in grasps if grasp.lift is not None and grasp.lift.success]
print(f"{len(lifted)} of {len(grasps)} certified grasps lift the ball")
if lifted:
    Path("grasp.html").write_text(xd.replay_lift(lifted[0], hand, scene))
    if xd.can_see():
        Image.fromarray(xd.render_grasp(lifted[0], hand, scene, size=(640, 480))).save("grasp.png")

# %% [markdown]
# A hand that is already in a plant of yours enters by `xd.hand_from_plant(plant, model_instance)`, its left twin is
# `xd.mirror(hand)`, and `xd.export_urdf(hand, "folder")` writes a file that MuJoCo, Pinocchio and yourdfpy open.
#
# **Exercise.** Turn the axis of one joint round in the URDF (`xyz="0 1 0"`, with its limits mirrored). What does the
# importer make of it?
