# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Judge grasps of another tool
#
# Success rates of different papers cannot be compared: each has its own format, its own simulator and its own idea of
# success. This tutorial takes files as other tools write them, says what their numbers mean, and asks the same judges
# of all: a certificate, a ruler, and protocols by name. It needs the library alone, runs in about a minute, and writes
# a few files into the working folder.

# %%
import pickle
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import yaml
from PIL import Image

import xdex_drake as xd
from xdex_drake.cli import main
from xdex_drake.visualization.pictures import contact_sheet

hand = xd.load_hand("allegro")
scene = xd.make_scene(xd.load_object("can"), seed=0)
grasps = [grasp for grasp in xd.synthesize(hand, scene, count=3, seed=0, time_limit_s=60.0) if grasp.lift is not None]
xd.save_grasps("ours.parquet", grasps, hand, scene)
if xd.can_see():
    pictures = [xd.render_grasp(grasp, hand, scene) for grasp in grasps]
    Image.fromarray(contact_sheet(pictures, [f"grasp {k}" for k in range(len(grasps))])).save("grasps.png")

# %% [markdown]
# ## A file of Isaac's format
#
# `xdex export` writes it, with keys beside those that Isaac reads. We leave these out, so that the file is as another
# tool would have it, and move every second wrist by a centimetre, as a method does that is not so exact.

# %%
main(["export", "ours.parquet", "--format", "isaac_grasp", "--out", "theirs.yaml"])
content = yaml.safe_load(Path("theirs.yaml").read_text())
plain = ("confidence", "position", "orientation", "cspace_position")
for k, (name, grasp) in enumerate(content["grasps"].items()):
    content["grasps"][name] = {key: grasp[key] for key in plain}
    if k % 2:
        content["grasps"][name]["position"][0] += 0.01
Path("theirs.yaml").write_text(yaml.safe_dump(content))

# %% [markdown]
# ## Judged as it is
#
# Nothing is moved or mended. Contacts are where shapes of the hand are within 2 mm of the mesh. The file has no squeeze
# and no open hand before: both are made by one rule, the same for every method, and that is told. From the shell this
# is `xdex judge theirs.yaml --hand allegro --object can`.

# %%
main(["judge", "theirs.yaml", "--workers", "0", "--out", "judged.parquet"])
for row in pq.read_table("judged.parquet").to_pylist():
    print(row["certified"], row["contacts"], f"{row['penetration_mm']:.1f} mm", row["reason"] or "-")

# %% [markdown]
# ## Names that do not travel
#
# Most files hold numbers without names: which link has this pose, and in which order are the joints? Nothing is
# guessed, since a wrong guess is another grasp and no error.

# %%
for one in content["grasps"].values():
    one["cspace_position"] = {f"rh_{joint}": value for joint, value in one["cspace_position"].items()}
content["gripper_frame"] = "/World/robot/tool0"
Path("nameless.yaml").write_text(yaml.safe_dump(content))
status = main(["judge", "nameless.yaml", "--object", "can"])
print("status", status, "| now with the frame told; a prefix of joint names needs no telling")
main(["judge", "nameless.yaml", "--frame", "base_link", "--workers", "0", "--out", "judged.parquet"])

# %% [markdown]
# ## A pickled dictionary
#
# DexGraspBench and its kin keep a pickled dictionary in a `.npy` file, rows of x, y, z, qw, qx, qy, qz and joint values
# in the order of their hand's file. A pickle can run anything when it is opened; here a reader opens it that knows
# arrays and containers and refuses all else.

# %%
rows = {}
for stage in ("pregrasp", "grasp", "squeeze"):
    packages = [xd.execution_package(grasp, hand, scene) for grasp in grasps]
    waypoints = [next(w for w in package["waypoints"] if w["name"] == stage) for package in packages]
    # Torques become targets beyond the surface, by the gain of 5 N m/rad that these files are for.
    targets = [np.add(w["position"], np.array(w["torque"]) / 5.0) for w in waypoints]
    rows[f"{stage}_qpos"] = np.array([[*w["X_WB"], *q] for w, q in zip(waypoints, targets, strict=True)])
pose = np.array([*scene.X_WO.translation(), *scene.X_WO.rotation().ToQuaternion().wxyz()])
bench = {**rows, "obj_pose": pose, "obj_path": "can"}
np.save("bench.npy", np.array(bench, dtype=object), allow_pickle=True)
told = ["--hand", "allegro", "--frame", "base_link", "--joint-order", "actuated"]
main(["judge", "bench.npy", *told, "--workers", "0", "--out", "judged.parquet"])
np.save("evil.npy", np.array({"grasp_qpos": pickle.Unpickler}, dtype=object), allow_pickle=True)
print("status", main(["judge", "evil.npy", *told]))

# %% [markdown]
# ## What success means
#
# The same grasps, by what different papers call success. `differs` says, in words, what is not as it was published.

# %%
for name in ("lift-0.2/2tips", "hold", "bench-fc", "push-6-weak", "shake-6-like"):
    protocol = xd.find_protocol(name)
    verdicts = [xd.lift(grasp, hand, scene, protocol=protocol) for grasp in grasps]
    passed = sum(verdict.passed for verdict in verdicts)
    reasons = {verdict.failure_reason for verdict in verdicts if verdict.failure_reason}
    print(f"{name:<15} {passed} of {len(verdicts)}", ", ".join(sorted(reasons)))
print("push-6-weak:", xd.find_protocol("push-6-weak").differs)

# %% [markdown]
# **Exercise.** Take a file of a tool that you use, and judge it by its own protocol and by `hold`. Which failures does
# the certificate foretell, and which do only simulators see?
