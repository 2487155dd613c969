"""The squeeze of a grasp that is to hold while it is pushed."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from xdex_drake.contact.passive import SqueezeSettings, check_squeeze, passive_squeeze
from xdex_drake.contact.patches import normal_spread
from xdex_drake.contact.stiffness import stops
from xdex_drake.grasping.passive import LOST, SQUEEZES, SURE, elastic_grasp, foretold_motion, holding_squeeze
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("box"))


@pytest.fixture(scope="module")
def grasps(hand, scene):
    settings = replace(SynthesisSettings(), batch=24)
    found = list(islice(candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally()), 3))
    assert found
    return found


def test_the_squeeze_is_foretold_to_hold_at_least_as_well_as_the_certificate(hand, scene, grasps):
    for grasp in grasps:
        k = Configuration.at(hand, grasp.X_WH, grasp.q)
        found = holding_squeeze(hand, k, scene, grasp.certificate)
        elastic = elastic_grasp(hand, k, scene, grasp.certificate, 1.0)
        own = np.array([contact.f_C for contact in grasp.certificate.contacts]).ravel()
        assert found.foretold <= max(SURE, foretold_motion(elastic, own) + 1e-12)
        assert np.all(np.abs(found.squeeze.torques) <= hand.effort)
        assert found.squeeze.f.shape == own.shape
        for settings in SQUEEZES:
            squeeze = passive_squeeze(elastic.stiffness, elastic.loads, own, settings)
            if squeeze.status == "solved":
                assert check_squeeze(squeeze, elastic.stiffness, elastic.loads, settings).passes(1e-5)


def test_uneven_contacts_move_more(hand, scene, grasps):
    squeezes = [holding_squeeze(hand, Configuration.at(hand, g.X_WH, g.q), scene, g.certificate) for g in grasps]
    best = int(np.argmin([found.foretold for found in squeezes]))
    grasp, f = grasps[best], squeezes[best].squeeze.f
    elastic = elastic_grasp(hand, Configuration.at(hand, grasp.X_WH, grasp.q), scene, grasp.certificate, 1.0)
    even, uneven = (replace(elastic, spread=np.full(len(elastic.spread), spread)) for spread in (0.0, 1.5))
    assert foretold_motion(even, f) < foretold_motion(uneven, f) <= np.log(LOST)


def test_stops_are_where_joints_stand_at_limits(hand):
    low, high = hand.limits
    q = 0.5 * (low + high)
    q[0], q[1] = low[0], high[1] - 1e-4
    side = stops(hand, q)
    assert side[0] == -1 and side[1] == 1 and not side[2:].any()


def test_normals_spread_across_edges_alone(scene):
    """The middle of a face is even; half of the points about an edge see the other face, at a right angle."""
    model = scene.object
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    middle, top = 0.5 * (low + high), np.array([0.0, 0.0, high[2]])
    face = np.array([middle[0], middle[1], 0.0]) + top
    edge = np.array([high[0], middle[1], 0.0]) + top
    spread = normal_spread(model, np.array([face, edge]), np.array([[0.0, 0.0, -1.0]] * 2))
    assert spread[0] == pytest.approx(0.0, abs=0.02)
    assert np.deg2rad(15.0) < spread[1] < np.deg2rad(60.0)


def test_demands_that_cannot_be_met_leave_the_certificate(hand, scene, grasps):
    grasp = grasps[0]
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    found = holding_squeeze(hand, k, scene, grasp.certificate, squeezes=(SqueezeSettings(joint_stiffness=2.0),))
    own = np.array([contact.f_C for contact in grasp.certificate.contacts]).ravel()
    assert np.array_equal(found.squeeze.f, own) and found.squeeze.margin == 0.0
