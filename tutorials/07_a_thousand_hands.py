# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # A thousand hands
#
# Generated hands come from a seed and a number: people's hands of many sizes, and variations of the five robot hands.
# This tutorial looks at some, takes one apart into the operations that made it, moves many hands in one batch, and
# carries one grasp to hands that differ. It needs the library alone, runs in about a minute, and writes `hands.html`.

# %%
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import xdex_drake as xd

# %% [markdown]
# ## A hand by its name
#
# `g0-0137` is hand 137 of seed 0, on every machine: no file is needed. Its description says where it comes from. The
# originals of Allegro, Shadow, Ability, Inspire and SVH are never among the generated hands, so that a model trained on
# these can be tested on those.

# %%
hands = [xd.load_hand(f"g0-{index:04d}") for index in (0, 1, 2, 3, 4, 7, 11, 12)]
for hand in hands:
    fingers = ", ".join(finger.name for finger in hand.fingers)
    print(f"{hand.name}: {len(hand.links)} links, {len(hand.joint_names)} motors; {fingers}")
print("history of", hands[1].name, "->", hands[1].sources["base"], "|", hands[1].sources["variation"])

# %% [markdown]
# `xdex hand generate --count 1000 --seed 0 --out hands` writes a thousand as files, and `xdex hand stats hands` counts
# and pictures them. The page below shows these few, with a slider for each joint.

# %%
Path("hands.html").write_text(xd.browser_page(hands, title="Eight generated hands"))
if xd.can_see():
    Image.fromarray(xd.hands_sheet(hands, columns=4, size=(240, 240))).save("hands.png")

# %% [markdown]
# ## Your own variations
#
# Operations are pure functions from hand to hand. `check_hand` names what is wrong with a result: a generator draws
# again, a person mends.

# %%
allegro = xd.load_hand("allegro")
small = xd.scale_hand(allegro, 0.8)
three = xd.remove_finger(small, "ring")
print(three.name, [finger.name for finger in three.fingers], "problems:", xd.check_hand(three))
person = xd.human_hand(xd.sample_shape(np.random.default_rng(0)))
print(person.display_name, "problems:", xd.check_hand(person))

# %% [markdown]
# ## Many hands in one batch
#
# A batch holds configurations of different hands: trees are padded to the largest. All is differentiable by torch; for
# one hand, `BatchedHand` also has the adjoint written out, which is several times faster.

# %%
padded = xd.PaddedHands(hands, dtype=torch.float64)
rows = torch.arange(len(hands)).repeat(100)
share = torch.full((len(rows), 1), 0.5, dtype=torch.float64, requires_grad=True)
low, high = padded.limits[rows].unbind(1)
eye, zero = torch.eye(3, dtype=torch.float64).expand(len(rows), 3, 3), torch.zeros((len(rows), 3), dtype=torch.float64)
poses = padded.forward(rows, eye, zero, low + share * (high - low))
height = (poses.p_WLs[..., 2] * padded.links[rows]).amax(1)
(slope,) = torch.autograd.grad(height.sum(), share)
print("reach of each hand at mid range [m]:", np.round(height[: len(hands)].detach().numpy(), 3))
print("and how it changes as all joints close:", np.round(slope[: len(hands), 0].numpy(), 3))

# %% [markdown]
# ## One grasp, many hands
#
# Retargeting asks corresponding fingertips and wrists to agree, by the fingers' names, under each hand's own hard
# constraints. Hands with fewer fingers keep what they can.

# %%
scene = xd.make_scene(xd.load_object("can"), seed=0)
source = next(g for g in xd.synthesize(allegro, scene, count=1, seed=0) if g.lift is not None and g.lift.success)
for hand in hands:
    outcome = xd.retarget(source, allegro, hand, scene)
    if outcome.grasp is None:
        print(f"{hand.name}: none, {outcome.reason} could not be met")
    else:
        lift = xd.lift(outcome.grasp, hand, scene)
        print(f"{hand.name}: certified, {'lifted' if lift.success else lift.failure_reason}")

# %% [markdown]
# **Exercise.** Take Allegro and scale it by 1.3, 1.6 and 2: at which size does the grasp of the can no longer carry
# over, and which constraint says so?
