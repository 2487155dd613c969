"""Fingers without contact rest near the object."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.contact.certificate import check_certificate
from xdex_drake.grasping.finish import GIVEN
from xdex_drake.grasping.idle import CLEARANCE, idle_fingers, idle_joints, rest_idle_fingers
from xdex_drake.grasping.squeeze import contact_torques
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.programs.force_closure import near_self_pairs
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("can"))


def tip_gaps(hand, scene, k, fingers):
    links = np.array([hand.link_index[finger.tip_link] for finger in fingers])
    tips = k.points(links, np.array([finger.p_LTip for finger in fingers]))
    return scene.object.exact.query((scene.X_WO.inverse() @ tips.T).T).distance


@pytest.mark.parametrize("name", list_hands())
def test_idle_joints_move_no_touching_link(name):
    hand = load_hand(name)
    links = [hand.fingers[0].tip_link, hand.fingers[1].links[-2]]
    joints = idle_joints(hand, links)
    assert joints.any() and not joints.all()
    assert [finger.name for finger in idle_fingers(hand, links)] == [finger.name for finger in hand.fingers[2:]]
    rng = np.random.default_rng(0)
    q = rng.uniform(*hand.limits)
    other = np.where(joints, rng.uniform(*hand.limits), q)
    a, b = (Configuration.at(hand, RigidTransform(), values) for values in (q, other))
    still = [hand.link_index[link] for finger in hand.fingers[:2] for link in finger.links]
    np.testing.assert_array_equal(a.p_WLs[still], b.p_WLs[still])
    moved = [hand.link_index[finger.tip_link] for finger in hand.fingers[2:]]
    assert (np.abs(a.p_WLs[moved] - b.p_WLs[moved]).max(axis=1) > 1e-6).all()


def test_a_hand_that_touches_with_all_fingers_stays(scene):
    hand = load_hand("allegro")
    k = Configuration.at(hand, RigidTransform([0.0, 0.0, 0.3]), hand.q_rest)
    assert rest_idle_fingers(hand, scene, k, [finger.tip_link for finger in hand.fingers]) is k


@pytest.mark.parametrize("name", ["allegro", "shadow"])
def test_idle_fingers_come_near_and_collide_with_nothing(name, scene):
    hand = load_hand(name)
    settings = replace(SynthesisSettings(), batch=24, demands=GIVEN)
    found = list(candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally()))
    before, after = [], []
    for grasp in found:
        links = [contact.link for contact in grasp.certificate.contacts]
        idle, joints = idle_fingers(hand, links), idle_joints(hand, links)
        # Stretched out, as a search leaves them.
        stretched = Configuration.at(hand, grasp.X_WH, np.where(joints, np.clip(0.0, *hand.limits), grasp.q))
        rested = rest_idle_fingers(hand, scene, stretched, links)
        np.testing.assert_array_equal(rested.q[~joints], stretched.q[~joints])
        assert np.all((rested.q >= hand.limits[0]) & (rested.q <= hand.limits[1]))
        if rested is stretched:
            continue
        before += list(tip_gaps(hand, scene, stretched, idle))
        after += list(tip_gaps(hand, scene, rested, idle))
        tolerance = 2.1e-4
        moved = np.isin(hand.sphere_links, [hand.link_index[link] for finger in idle for link in finger.links])
        ways = []
        for k in (stretched, rested):
            centers = k.points(hand.sphere_links, hand.spheres[:, :3])
            gaps = scene.object.exact.query((scene.X_WO.inverse() @ centers.T).T).distance - hand.spheres[:, 3]
            heights = centers[:, 2] - hand.spheres[:, 3]
            a, b = near_self_pairs(hand, k).T
            apart = np.linalg.norm(centers[a] - centers[b], axis=1) - hand.spheres[a, 3] - hand.spheres[b, 3]
            ways.append((gaps[moved].min(), heights.min(), apart.min()))
        (gap0, height0, apart0), (gap, height, apart) = ways
        assert gap >= min(CLEARANCE, gap0) - tolerance
        assert height >= min(2e-3, height0) - tolerance
        assert apart >= min(1e-3, apart0) - tolerance
    assert len(before) >= 3
    assert np.mean(after) <= 0.6 * np.mean(before)


def test_finished_grasps_keep_their_certificate(scene):
    hand = load_hand("allegro")
    settings = replace(SynthesisSettings(), batch=24)
    for grasp in candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally()):
        links = [contact.link for contact in grasp.certificate.contacts]
        idle = idle_joints(hand, links)
        k = Configuration.at(hand, grasp.X_WH, grasp.q)
        assert np.all(contact_torques(hand, k, scene, grasp.certificate)[idle] == 0.0)
        assert np.all(grasp.tau_squeeze[idle] == 0.0)
        assert check_certificate(grasp.certificate).passes(1e-6)
        assert np.abs(tip_gaps(hand, scene, k, [f for f in hand.fingers if f.tip_link in links])).max() < 0.03
