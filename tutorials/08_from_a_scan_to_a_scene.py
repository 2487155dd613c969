# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # From a scan to a scene
#
# A mesh from a scanner or a web page is seldom what a solver wants: its unit is a secret, triangles are missing or
# inside out, and nothing in it is convex. This tutorial makes such a mesh, imports it, reads what was mended, asks how
# well the convex parts follow it, finds the poses in which it rests, and looks at it with a depth camera. It needs the
# library alone, takes less than a minute, most of it for the convex parts, which are kept in a cache,
# and writes `scan.stl` into the working folder.

# %%
import numpy as np
import trimesh
from PIL import Image

import xdex_drake as xd

# %% [markdown]
# ## A scan as bad as they come
#
# A funnel-like vase in millimetres: as STL writes it, with three vertices of its own for each triangle, half of the
# triangles turned inside out, some given twice, a few lost, and a scrap of the turntable that floats beside it.

# %%
profile = np.array([[0, 0], [24, 0], [28, 20], [20, 55], [26, 90], [23, 90], [16, 55], [23, 22], [20, 4], [0, 4]])
vase = trimesh.creation.revolve(profile, sections=40)
rng = np.random.default_rng(0)
triangles = vase.triangles.copy()
flipped = rng.random(len(triangles)) < 0.5
triangles[flipped] = triangles[flipped][:, ::-1]
scrap = np.array([[[40.0, 0.0, 0.0], [41.0, 0.0, 0.0], [40.0, 1.0, 0.2]]])
triangles = np.concatenate([np.delete(triangles, [150, 151, 400, 401], axis=0), triangles[100:120], scrap])
soup = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)
soup.export("scan.stl")
print(f"{len(soup.faces)} triangles, {len(soup.vertices)} vertices, closed: {soup.is_watertight}")

# %% [markdown]
# ## Import
#
# One call reads, mends and splits. Nothing is done in silence: each repair is a sentence. The unit was guessed because
# an object of 90 m fits no hand; `scale=0.001` says it for certain. On the command line, `xdex object import scan.stl`
# does the same, writes a clean mesh and an `index.csv`, and takes whole folders.

# %%
vase_model = xd.load_object("scan.stl", density=2400.0)
report = vase_model.report
for repair in report.repairs:
    print("-", repair)
print("scale:", vase_model.scale, "| closed now:", report.watertight)

# %% [markdown]
# ## Is its volume its mass?
#
# Not that of the space that it fills. A vase is a shell: twice the volume over the area is the mean thickness of its
# walls, and a density stands for the material of the walls. The grasping programs, the certificate and the simulation
# all take mass, center of mass and inertia from here.

# %%
hull = vase_model.mass * float(trimesh.Trimesh(vase_model.vertices).convex_hull.volume) / report.volume
print(
    f"walls of {1e3 * (report.wall or 0.0):.1f} mm, mass {1e3 * vase_model.mass:.0f} g; as a solid: {1e3 * hull:.0f} g"
)

# %% [markdown]
# ## Convex parts, and what they cost
#
# Contacts, distances and simulation use the union of convex parts. It cannot lie on the mesh exactly. The *bulge* is
# how far the parts stand out of the mesh, at the 99th percentile of their surface, and the *gap* is how far the mesh
# stands out of them. A fingertip that rests on a bulge of 1 mm hovers by that much over the real object.

# %%
print(f"{report.parts} parts, bulge {1e3 * report.bulge_p99_m:.2f} mm, gap {1e3 * report.gap_p99_m:.2f} mm")
print(f"{report.seconds:.1f} s the first time, from the cache ever after")

# %% [markdown]
# ## How it rests
#
# Each facet of the convex hull below which the center of mass lies is a pose of rest, with the probability that a drop
# from a random orientation ends there. Poses that differ by a turn about the vertical or by the object's symmetry are
# one, and each is confirmed by letting the object go in simulation.

# %%
for pose in xd.stable_poses(vase_model):
    up = pose.X_WO.rotation().matrix()[2]
    print(f"probability {pose.probability:.2f}, up is {np.round(up, 2) + 0.0} of the object")

# %% [markdown]
# `make_scene` takes the most probable pose for seed 0 and draws one for other seeds; `random_scene` draws size and
# place, too, as the scenes of XDex are drawn.

# %%
scene = xd.make_scene(vase_model, seed=0)
print("scene", scene.scene_id, "| origin at", np.round(scene.X_WO.translation(), 3))
for seed in (1, 2, 3):
    other = xd.random_scene("can", seed=seed)
    print("can, scale", other.object.scale, "at", np.round(other.X_WO.translation(), 3))

# %% [markdown]
# ## What a robot would see
#
# A depth camera sees one side, with noise that grows with distance, and loses what it sees at a grazing angle. The
# points are in the world frame, as those of `point_cloud`, which cover the whole surface.

# %%
whole, _ = xd.point_cloud(scene, 2000)
if xd.can_see():
    camera = xd.camera_poses(scene, 1, np.random.default_rng(1))[0]
    seen = xd.depth_cloud(scene, camera)
    p_OPs = (seen - scene.X_WO.translation()) @ scene.X_WO.rotation().matrix()
    error = np.abs(vase_model.mesh_distance.query(p_OPs).distance)
    near = np.linalg.norm(whole[:, None] - seen[None, ::5], axis=2).min(axis=1) < 5e-3
    print(
        f"{len(seen)} points, {1e3 * np.median(error):.2f} mm off in the median; {near.mean():.0%} of the surface seen"
    )
else:
    print("this machine cannot render; the whole cloud has", len(whole), "points")

# %% [markdown]
# ## The whole way, with a grasp
#
# The scene is like any other now.

# %%
hand = xd.load_hand("allegro")
for grasp in xd.synthesize(hand, scene, count=1, seed=0, time_limit_s=20.0):
    assert grasp.lift is not None
    print("lifted" if grasp.lift.success else f"failed: {grasp.lift.failure_reason}")
    if xd.can_see():
        Image.fromarray(xd.render_grasp(grasp, hand, scene, size=(640, 480))).save("vase.png")

# %% [markdown]
# **Exercise.** Cut the vase's inner wall away, so that only the outer surface is left, open at the top. What does the
# importer say of it now, and what becomes of the mass? Then cut a hole of a square centimetre into the closed vase: at
# which size of the hole does it become a shell?
