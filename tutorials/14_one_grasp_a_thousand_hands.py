# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # One grasp, a thousand hands
#
# A person's grasp becomes the same grasp by hands that differ in size, in joints and in the number of fingers. This is
# how paired data are made, a thousand hands at a time. Here we take one grasp of one object and see what becomes of it:
# which hands lift, how alike the grasps are, and how they look side by side, as in Fig. 1 of the paper. It needs the
# library alone, runs in about a minute, and writes `one_grasp.png`.

# %%
import dataclasses

import numpy as np
from PIL import Image

import xdex_drake as xd
from xdex_drake.dataset.files import StoredGrasp
from xdex_drake.evaluation.consistency import consistency, diversity, keypoints, matched_pairs
from xdex_drake.evaluation.metrics import wilson_interval
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.visualization.versions import picture_of_versions

# %% [markdown]
# ## The source
#
# Every fifth generated hand is a person's, of a size drawn from published anthropometry. Sources of paired data come
# from these: a person's hand has all five fingers, and most robot hands imitate it.

# %%
person = xd.load_hand("g0-0005")
scene = xd.make_scene(xd.load_object("can"), seed=0)
source = next(g for g in xd.synthesize(person, scene, count=1, seed=0) if g.lift is not None and g.lift.success)
source = dataclasses.replace(source, grasp_id="source")
print(person.display_name, "lifts the can with", len(source.certificate.contacts), "contacts")

# %% [markdown]
# ## To other hands
#
# `retarget` asks the fingertips that correspond by name, and the wrist, to be where the person's are, under the
# constraints of the other hand: contacts on the surface, no penetration, forces that hold the object. Where that fails
# as it stands it tries again from jittered starts, and with other fingers. What it finds is certified; only the lift
# tells whether it was right. Names are all it takes: `g0-0137` is a hand on every machine.

# %%
names = ["shadow", "allegro", "ability", "inspire", "g0-0010", "g0-0137", "g0-0003", "g0-0101"]
stored, lifted = [StoredGrasp(source, person, scene, SceneFacts.of(scene), {}, person.name)], []
for name in names:
    hand = xd.load_hand(name)
    outcome = xd.retarget(source, person, hand, scene)
    if outcome.grasp is None:
        print(f"{name}: none, {outcome.reason}")
        lifted.append(False)
        continue
    grasp = dataclasses.replace(outcome.grasp, source_grasp_id="source", lift=xd.lift(outcome.grasp, hand, scene))
    print(f"{name}: {'lifted' if grasp.lift.success else grasp.lift.failure_reason}")
    lifted.append(grasp.lift.success)
    if grasp.lift.success:
        stored.append(StoredGrasp(grasp, hand, scene, SceneFacts.of(scene), {}, name))

# %% [markdown]
# Few attempts tell little: Wilson's interval says how little. `xdex dataset generate` makes attempts by the thousand,
# and the card of a data set has the rate of each kind of hand.

# %%
low, high = wilson_interval(sum(lifted), len(lifted))
print(f"lifted {sum(lifted)} of {len(lifted)}; the rate is between {low:.2f} and {high:.2f}")

# %% [markdown]
# ## Side by side
#
# Each picture is of another hand, from one side and at one scale; colors go by the finger's name.

# %%
if xd.can_see():
    Image.fromarray(picture_of_versions(stored)).save("one_grasp.png")

# %% [markdown]
# ## How alike
#
# Two measures of the paper, over pairs of versions by different hands. The position difference is the mean distance of
# corresponding fingertips and of the wrists in the world: the place of the grasp. The vector difference takes each
# fingertip in its own wrist frame: the shape of the hand. A larger hand has its wrist farther away while its fingertips
# touch the same points, so that one grasp by two hands is never quite the same.

# %%
pairs = [(item.hand, item.grasp) for item in stored]
found = consistency(keypoints(pairs), matched_pairs([grasp for _, grasp in pairs]))
print(f"{found.pairs} pairs: position {found.position_cm:.1f} cm, vector {found.vector_cm:.1f} cm")
ways = diversity(pairs, scene)
print(
    f"of {ways.lifted} lifted grasps {ways.distinct} are 2 cm or more apart; they reach {ways.coverage:.0%} of the can"
)
assert found.pairs and np.isfinite(found.position_cm)

# %% [markdown]
# ## A thousand
#
# The same in one command, over scenes and hands that are drawn by seed; it can be stopped and goes on. The next
# tutorial kills it.
#
# ```sh
# xdex dataset generate studies/pairs/dataset.yaml --out pairs --workers 8
# xdex dataset metrics pairs
# xdex dataset card pairs
# ```
#
# **Exercise.** Take a pinch as the source: `settings=SynthesisSettings(search=SearchSettings(grasp_type="pinch"))`, of
# `xdex_drake.grasping.synthesis` and `xdex_drake.programs.search`. Which hands lift it now, and is the position
# difference smaller or larger?
