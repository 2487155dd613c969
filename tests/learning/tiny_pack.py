"""A training pack made of nothing but NumPy: `python tests/learning/tiny_pack.py FILE.safetensors` writes one."""

import sys

import numpy as np

from xdex_drake.learning.pack import JOINT_FEATURES, NORMAL, Pack, write_pack

FINGERS = ("thumb", "index", "middle")
LENGTH = 0.04
POINTS = 256


def turn(angles):
    """Rotations about the y axis, shape (n, 3, 3)."""
    c, s, o = np.cos(angles), np.sin(angles), np.zeros_like(angles)
    return np.stack([c, o, s, o, o + 1.0, o, -s, o, c], axis=-1).reshape(-1, 3, 3)


def link_poses(fingers, joints, closing):
    """Links in H of a palm with straight fingers, each joint turned by `closing`: rotations and centers."""
    R, p = [np.eye(3)], [np.zeros(3)]
    for f in range(fingers):
        turned = turn(closing * np.arange(1, joints + 1))
        origin = np.array([0.0, 0.03 - 0.03 * f, 0.08])
        for j in range(joints):
            R.append(turned[j])
            p.append(origin + turned[j] @ [0.0, 0.0, LENGTH / 2])
            origin = origin + turned[j] @ [0.0, 0.0, LENGTH]
    return np.array(R), np.array(p)


def distances(fingers, joints):
    """Number of joints between two links."""
    finger = np.array([-1] + [f for f in range(fingers) for _ in range(joints)])
    depth = np.array([0] + [j + 1 for _ in range(fingers) for j in range(joints)])
    same = finger[:, None] == finger
    return np.where(same, abs(depth[:, None] - depth), depth[:, None] + depth)


def tiny_pack(scenes=6, grasps=8, seed=0, shapes=((3, 2), (2, 2))):
    """Two hands of unequal numbers of links that grasp ellipsoids along their normals, in pairs."""
    rng = np.random.default_rng(seed)
    names = ("wrist", *FINGERS)
    links = np.array([1 + fingers * joints for fingers, joints in shapes])
    directions = rng.normal(size=(links.sum(), 16, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    centers = np.concatenate([link_poses(*shape, 0.0)[1] for shape in shapes])
    motions = np.zeros((links.sum(), JOINT_FEATURES))
    motions[:, [1, 3]], motions[:, 6], motions[:, 8] = 0.5, -0.2, 1.0  # about y, from 0 to 1
    motions[np.cumsum(links) - links] = 0.0
    keypoint_links = np.full((len(shapes), len(names)), -1)
    offsets = np.zeros((len(shapes), len(names), 3))
    for h, (fingers, joints) in enumerate(shapes):
        keypoint_links[h, : fingers + 1] = [0, *(1 + joints * np.arange(1, fingers + 1) - 1)]
        offsets[h, 1:, 2] = LENGTH / 2

    axes = rng.uniform(0.02, 0.05, (scenes, 1, 3))
    on_sphere = rng.normal(size=(scenes, POINTS, 3))
    on_sphere /= np.linalg.norm(on_sphere, axis=-1, keepdims=True)
    clouds, normals = on_sphere * axes, on_sphere / axes
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    chosen = rng.integers(POINTS, size=(scenes, grasps))
    closings = rng.uniform(0.1, 0.8, (scenes, grasps))
    points, vectors = [], []
    for shape in shapes:
        for s, g in np.ndindex(scenes, grasps):
            z = -normals[s, chosen[s, g]]
            x = np.cross(np.cross(z, [0.3, 0.2, 0.9]), z)
            x /= np.linalg.norm(x)
            R_WH = np.stack([x, np.cross(z, x), z], axis=1)
            R, p = link_poses(*shape, closings[s, g])
            R, p = R_WH @ R, (p - [0.0, 0.0, 0.12]) @ R_WH.T
            vectors.append(np.concatenate([p, R[..., 0], R[..., 1]], axis=-1))
            points.append(clouds[s, chosen[s, g]])
    per_hand = scenes * grasps
    scene = np.tile(np.repeat(np.arange(scenes), grasps), len(shapes))
    return Pack(
        hand_names=tuple(f"toy_{fingers}x{joints}" for fingers, joints in shapes),
        keypoint_names=names,
        scene_names=tuple(f"ellipsoid_{s}" for s in range(scenes)),
        reasons=("", "slipped"),
        links=links.astype(np.int32),
        link_points=(centers[:, None] + 0.01 * directions).astype(np.float16),
        link_normals=np.rint(NORMAL * directions).astype(np.int8),
        link_centers=centers.astype(np.float32),
        link_joints=motions.astype(np.float16),
        spd=np.concatenate([distances(*shape).ravel() for shape in shapes]).astype(np.uint8),
        keypoint_links=keypoint_links.astype(np.int16),
        keypoint_offsets=offsets.astype(np.float32),
        clouds=clouds.astype(np.float16),
        cloud_normals=np.rint(NORMAL * normals).astype(np.int8),
        centers=np.pad(axes[:, :, 2], ((0, 0), (2, 0))).astype(np.float32),
        hand=np.repeat(np.arange(len(shapes)), per_hand).astype(np.int32),
        scene=scene.astype(np.int32),
        pair=np.tile(np.arange(per_hand), len(shapes)).astype(np.int32),
        outcome=np.zeros(len(shapes) * per_hand, dtype=np.int16),
        points=np.array(points).astype(np.float32),
        vectors=np.concatenate(vectors).astype(np.float16),
        held_scenes=np.zeros(scenes, dtype=np.uint8),
        held_hands=np.zeros(len(shapes), dtype=np.uint8),
    )


if __name__ == "__main__":
    write_pack(tiny_pack(), sys.argv[1])
