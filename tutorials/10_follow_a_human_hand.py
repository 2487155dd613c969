# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Follow a human hand
#
# A camera or a glove gives 21 key points of a person's hand, frame by frame. This tutorial turns them into joint values
# of hands that have fewer fingers, coupled joints or another size, looks at what each objective compares, and writes a
# page that plays the motion. It needs the library alone, runs in seconds, and writes `follow.html` into the working
# folder.

# %%
import time
from pathlib import Path

import numpy as np
from PIL import Image
from pydrake.math import RigidTransform, RotationMatrix

import xdex_drake as xd
from xdex_drake.evaluation.judge import certified_as_given
from xdex_drake.grasping.finish import penetrations
from xdex_drake.visualization.hand_sets import hand_picture

# %% [markdown]
# ## A clip without a camera
#
# The clip comes from the library's human hand, which reaches, grasps and lifts. Points are in metres, in any frame: the
# wrist, then four points a finger from the palm to the tip, thumb first. This is the order of MediaPipe. Your own clip
# is a `.npy` file of shape (T, 21, 3), read by `xd.read_points`.

# %%
clip = xd.reach_grasp_lift(seconds=3.0, frames_per_second=30.0, noise_m=5e-4)
print("points", clip.points.shape, "| wrist travels", np.round(np.ptp(clip.p_WH, axis=0), 2), "m")
gap = np.linalg.norm(clip.points[:, 4] - clip.points[:, 8], axis=1)
print(f"thumb to index: {100 * gap.max():.1f} cm open, {100 * gap.min():.1f} cm closed")

# %% [markdown]
# ## One hand follows
#
# Fingers correspond by their names. The wrist frame is seen from wrist and knuckles, and the hand's own wrist frame is
# laid upon it, so that joints alone are sought. `calibrated` measures the person's hand along its joints, which no
# posture changes, and sets the scale.

# %%
hand = xd.load_hand("allegro")
retargeter = xd.HandRetargeter(hand, "vector").calibrated(clip.points[:10])
print("lacking fingers:", retargeter.missing, "| scale", round(retargeter.scale, 2))
stream = retargeter.stream()
start = time.process_time()
frames = [stream.follow(points) for points in clip.points]
print(f"{1e3 * (time.process_time() - start) / len(frames):.2f} ms a frame, each from the joint values of the last")
q = np.array([frame.q for frame in frames])
error = np.array([frame.error for frame in frames])
print(f"mean distance {1e3 * error.mean():.1f} mm, greatest step {np.abs(np.diff(q, axis=0)).max():.2f} rad")

# %% [markdown]
# ## Couplings and limits
#
# Five motors and a thumb that turns: Inspire's other joints follow by a law. The law is inside the problem, not applied
# afterwards, so that fingertips are where the solver believes them to be.

# %%
inspire = xd.load_hand("inspire")
batch = xd.HandRetargeter(inspire, "vector").calibrated(clip.points[:10]).batch(clip.points)
q_full = inspire.q_full(batch.q)
print(f"{len(inspire.joint_names)} motors move {q_full.shape[1]} joints")
low, high = inspire.limits
print("within limits:", bool(((batch.q >= low) & (batch.q <= high)).all()))

# %% [markdown]
# ## What is compared
#
# *position* compares fingertips coordinate by coordinate, *vector* the vectors from the wrist to them by their length,
# *dexpilot* also vectors between fingertips, which become a pinch once the person's thumb comes near a finger. How far
# the tips of thumb and index finger are apart at the end shows the difference.

# %%
tips = [finger for finger in hand.fingers if finger.name in ("thumb", "index")]
links = np.array([hand.link_index[finger.tip_link] for finger in tips])
p_LTips = np.array([finger.p_LTip for finger in tips])
for objective in ("position", "vector", "dexpilot"):
    follower = xd.HandRetargeter(hand, objective, scale=1.0 if objective == "position" else retargeter.scale)
    *_, last = follower.follow(clip.points)
    thumb, index = xd.Configuration.at(hand, RigidTransform(), last.q).points(links, p_LTips)
    print(
        f"{objective:<9} thumb to index {1e3 * np.linalg.norm(thumb - index):5.1f} mm, error {1e3 * last.error:.1f} mm"
    )

# %% [markdown]
# ## Noise
#
# A camera's points tremble. `smoothing` adds the squared joint increments of a frame to its objective; nothing is
# filtered afterwards, so that a hand at rest is where the objective wants it, a little later.

# %%
noisy = xd.reach_grasp_lift(noise_m=3e-3)
for smoothing in (0.0, 4e-3, 4e-2):
    follower = xd.HandRetargeter(hand, "vector", scale=retargeter.scale, smoothing=smoothing)
    path = np.array([frame.q for frame in follower.follow(noisy.points)])
    still = np.abs(np.diff(path[-20:], axis=0)).mean()
    print(f"smoothing {smoothing:<6} tremble at the end {1e3 * still:.1f} mrad a frame")

# %% [markdown]
# ## A left hand
#
# Points of a left hand move a left hand, or the right one as its mirror image.

# %%
left = xd.reach_grasp_lift(side="left").points
own = xd.HandRetargeter(xd.mirror(hand), scale=1.4).frame(left[60])
crossed = xd.HandRetargeter(hand, scale=1.4, side="left").frame(left[60])
print("same joint values:", bool(np.allclose(own.q, crossed.q, atol=1e-6)))

# %% [markdown]
# ## An object in the way
#
# Kinematics knows no object: where the person held something, a larger hand closes through it. Beside an object each
# frame goes as far as it can: links stay outside, joints move by no more than 0.19 rad a frame, and fingers that press
# go on touching. The ball is where this hand's fingers would meet; it goes along while thumb and a finger hold it.
# `xdex follow allegro points.npy --object ball --at X Y Z` does it for a file.

# %%
ball = xd.load_object("ball", scale=0.7)
shadow = xd.load_hand("shadow")
fifth = xd.HandRetargeter(shadow, "vector").calibrated(clip.points[:10])
closed = fifth.scaled_points(clip.points)[62]
X_WO = RigidTransform(0.5 * (closed[4] + closed[[8, 12]].mean(axis=0)))
beside = list(xd.follow_beside(fifth, clip.points, ball, X_WO))


def depth(X_WH: RigidTransform, q: np.ndarray, X_WO: RigidTransform) -> float:
    """How deep the hand is in the ball [mm]."""
    k = xd.Configuration.at(shadow, X_WH, q)
    return 1e3 * max(penetrations(shadow, k, xd.Scene(ball, X_WO, "ball")))


plain = [depth(RigidTransform(RotationMatrix(f.wanted.R_WH), f.wanted.p_WH), f.wanted.q, f.X_WO) for f in beside[::3]]
ours = [depth(f.X_WH, f.q, f.X_WO) for f in beside[::3]]
print(f"deepest: {max(plain):.1f} mm without the ball in mind, {max(ours):.2f} mm with it")
steps = np.abs(np.diff([frame.q for frame in beside], axis=0)).max()
print(f"greatest step {steps:.2f} rad; touching at the end: {', '.join(beside[-1].touching)}")

# %% [markdown]
# A frame is a grasp like any other, and can be asked whether it holds.

# %%
last = beside[-1]
grasp = xd.Grasp("shadow", "ball", last.X_WO, last.X_WH, last.q)
grasp, found = certified_as_given(shadow, xd.Scene(ball, last.X_WO, "ball"), grasp)
print(
    "certified:", grasp.certificate is not None, "|", found.reason or f"task margin {found.certificate.task_margin:.1f}"
)

# %% [markdown]
# ## Look at it
#
# The page plays the motion with the scaled key points. `xdex follow allegro points.npy --html follow.html` does all of
# this from the command line.

# %%
R_WH, p_WH = np.array([frame.R_WH for frame in frames]), np.array([frame.p_WH for frame in frames])
page = xd.motion_page(hand, q, R_WH, p_WH, points=retargeter.scaled_points(clip.points), title="Allegro follows")
Path("follow.html").write_text(page)
if xd.can_see():
    closed = hand_picture(hand, q=q[-1], size=(480, 480))
    Image.fromarray(closed).save("follow.png")
print("follow.html:", Path("follow.html").stat().st_size // 1000, "kB")

# %% [markdown]
# **Exercise.** Put a can where the ball was. How small must it be until a hand of four fingers holds it by this motion,
# and how do you move the can so that it does?
