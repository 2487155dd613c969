"""Synthetic hands and grasps: small, exact, and free of any file."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform

from xdex_drake.hand.description import Box, Capsule, Convex, Coupling, Finger, Hand, Joint, Link, Sphere
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.learning.features import hand_features, link_frames, object_features
from xdex_drake.learning.pack import HandFeatures, ObjectFeatures, Pack
from xdex_drake.learning.samples import HandGrasps, make_pack

torch.set_num_threads(1)  # so that sums have one order, whatever the shell says

FINGERS = ("thumb", "index", "middle", "ring", "little")


def _link(name: str, geometry: tuple) -> Link:
    return Link(name, geometry, 0.05, np.zeros(3), 1e-5 * np.eye(3), np.zeros((0, 4)))


def make_hand(fingers: int = 3, joints: int = 2, size: float = 1.0, name: str = "toy") -> Hand:
    """A box with fingers of capsules; the last joint of each finger is coupled to the one before it."""
    c, s = np.cos(0.2), np.sin(0.2)
    links = [_link("palm", (Box(size * np.array([0.03, 0.08, 0.09]), np.array([0.0, 0.0, 0.05])),))]
    joint_list, finger_list = [], []
    for f, finger in enumerate(FINGERS[:fingers]):
        parent, names = "palm", []
        for j in range(joints):
            child = f"{finger}_{j}"
            length = size * 0.04
            shapes = (
                (Capsule(np.zeros(3), np.array([0.0, 0.0, length]), 0.008),),
                (Sphere(np.array([0.0, 0.0, length / 2]), 0.012),),
                (Convex(0.01 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 4])).reshape(3, -1).T),),
                (),
            )
            links.append(_link(child, shapes[(f + j) % 4]))
            origin = np.array([0.0, 0.0, length]) if j else size * np.array([0.01, 0.03 - 0.02 * f, 0.09])
            coupled = j == joints - 1 and j > 0
            joint_list.append(
                Joint(
                    name=f"{child}_joint",
                    kind="revolute",
                    parent=parent,
                    child=child,
                    p_PJ=origin,
                    R_PJ=np.eye(3),
                    axis=np.array([0.0, 1.0, 0.0]),
                    lower=0.0,
                    upper=1.6,
                    effort=1.0,
                    coupling=Coupling(f"{finger}_{j - 1}_joint", 0.8, 0.1) if coupled else None,
                )
            )
            names.append(child)
            parent = child
        tip = np.array([0.0, 0.0, size * 0.04])
        finger_list.append(Finger(finger, tuple(names), names[-1], tip, np.array([1.0, 0.0, 0.0])))
    n = sum(joint.coupling is None for joint in joint_list)
    return Hand(
        name=name,
        display_name=name,
        side="right",
        links=tuple(links),
        joints=tuple(joint_list),
        fingers=tuple(finger_list),
        p_HB=np.array([0.0, 0.0, 0.02]),
        R_HB=np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]),
        q_rest=np.full(n, 0.4),
        sources={},
    )


class TrainingSet(NamedTuple):
    """Hands, scenes and grasps in full precision, and the pack that is made of them."""

    hands: tuple[HandFeatures, ...]
    scenes: tuple[ObjectFeatures, ...]
    grasps: tuple[HandGrasps, ...]
    pack: Pack


def make_training_set(scenes: int = 6, grasps: int = 8, seed: int = 0) -> TrainingSet:
    """Grasps of ellipsoids that head for a surface point along its normal, in pairs of two hands."""
    rng = np.random.default_rng(seed)
    hands = (make_hand(3, 2, name="three"), make_hand(2, 3, 1.2, name="two"))
    features = tuple(hand_features(hand, points=32) for hand in hands)
    objects: list[ObjectFeatures] = []
    poses: dict[int, list] = {0: [], 1: []}
    for s in range(scenes):
        axes = rng.uniform(0.02, 0.05, 3)
        directions = rng.normal(size=(2000, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        center = np.array([0.1 * s, -0.1, axes[2]])
        normals = directions / axes
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        surface = directions * axes + center
        objects.append(object_features(surface, center, count=2000, name=f"ellipsoid_{s}", n_WPoints=normals))
        for _ in range(grasps):
            k = rng.integers(len(directions))
            closing = rng.uniform(0.1, 1.2)
            z = -normals[k]
            x = np.cross(np.cross(z, [0.3, 0.2, 0.9]), z)
            x /= np.linalg.norm(x)
            R_WH = np.stack([x, np.cross(z, x), z], axis=1)
            p_WH = surface[k] - R_WH @ np.array([0.0, 0.0, 0.12])
            for h, hand in enumerate(hands):
                R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), np.full(len(hand.joint_names), closing))
                poses[h].append((R_WH @ R_HLs, p_HLs @ R_WH.T + p_WH, surface[k]))
    count = scenes * grasps
    parts = []
    for h, hand in enumerate(features):
        R_WLs, p_WLs, p_WPoints = (np.array(entry) for entry in zip(*poses[h], strict=True))
        frames = link_frames(hand, R_WLs, p_WLs)
        scene = np.repeat(np.arange(scenes), grasps)
        parts.append(HandGrasps(hand, scene, *frames, p_WPoints, np.arange(count), np.zeros(count, dtype=int)))
    return TrainingSet(features, tuple(objects), tuple(parts), make_pack(objects, parts))


@pytest.fixture(scope="session")
def toy_hand() -> Hand:
    return make_hand()


@pytest.fixture(scope="session")
def hand_maker() -> Callable[..., Hand]:
    return make_hand


@pytest.fixture(scope="session")
def training_set() -> TrainingSet:
    return make_training_set()


@pytest.fixture(scope="session")
def tiny() -> Callable[..., Pack]:
    """Makes a training pack without Drake, as a machine does that has torch alone."""
    spec = importlib.util.spec_from_file_location("tiny_pack", TINY_PACK)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.tiny_pack


TINY_PACK = Path(__file__).parent / "tiny_pack.py"
