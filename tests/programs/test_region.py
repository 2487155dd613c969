"""Contacts in a part of the object."""

import numpy as np
import pytest
import torch
import trimesh
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.programs.force_closure import contact_set
from xdex_drake.programs.point import Point
from xdex_drake.programs.search import SearchSettings, places_in
from xdex_drake.programs.terms.region import MARGIN, InRegion, region_block
from xdex_drake.scene.object import load_object
from xdex_drake.scene.region import Region, read_region
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("bottle"))


def test_a_box_and_its_mesh_are_the_same_region():
    box = read_region("x=-0.02:0.02,y=-0.03:0.03,z=0.05:0.1")
    mesh = trimesh.creation.box(bounds=[box.low, box.high])
    same = Region(vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces))
    points = np.random.default_rng(0).uniform(-0.1, 0.2, size=(200, 3))
    for one, other in zip(box.distances(points), same.distances(points), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
    half = read_region("z=0.1:")
    assert half.distances(np.array([[5.0, 5.0, 0.3]]))[0] == pytest.approx(-0.2)


@pytest.mark.parametrize("text", ["top", "z=1", "z=a:b", "w=0:1", "z=0.2:0.1", ""])
def test_what_is_no_region_is_told_how_to_write(text):
    with pytest.raises(ConfigError, match="region"):
        read_region(text)


def test_a_region_that_holds_nothing_is_told(scene):
    with pytest.raises(ConfigError, match="in its frame it reaches from"):
        places_in(scene, read_region("z=0.5:"))


def test_program_and_search_pull_the_same_way(scene):
    hand, region = load_hand("allegro"), read_region("z=0.1:")
    k = Configuration.at(hand, RigidTransform([-0.06, 0.0, 0.02]), hand.q_rest)
    contacts = contact_set(hand, scene, k, np.ones(len(hand.fingers), bool))
    point = Point(k, scene, contacts, np.zeros((len(hand.fingers), 3)))
    block = region_block(region, len(contacts.spheres))
    step = 1e-6 * np.random.default_rng(1).normal(size=point.size)
    change = (block.at(point.moved(step))[0] - block.at(point.moved(-step))[0]) / 2.0
    near = point.contact_gaps < 0.02  # where the grid of smooth normals reaches
    assert near.any()
    np.testing.assert_allclose(change[near], (block.at(point)[1] @ step)[near], rtol=0.1, atol=5e-5)

    class Contacts:
        contacts_W, touching = point.contacts_W, np.ones(len(contacts.spheres))

    class Batch:
        contacts_W, touching = (
            torch.tensor(np.stack([values] * 2)) for values in (Contacts.contacts_W, Contacts.touching)
        )

    value, pull = InRegion(region, scene).evaluate(Contacts)
    values, pulls = InRegion(region, scene).evaluate(Batch)
    np.testing.assert_allclose(values.numpy(), value, atol=1e-9)
    np.testing.assert_allclose(pulls.contacts_W[1].numpy(), pull.contacts_W, atol=1e-9)
    out = block.at(point)[0] / 1e3 + MARGIN
    assert value == pytest.approx(np.maximum(out, 0.0).sum())


def test_grasps_keep_to_the_region(scene):
    hand, region = load_hand("allegro"), read_region("z=0.06:")
    settings = SynthesisSettings(search=SearchSettings(region=region), batch=32)
    found = candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally())
    points = [contact.p_OC for _, g in zip(range(2), found, strict=False) for contact in g.certificate.contacts]
    assert len(points) >= 4 and min(p[2] for p in points) >= 0.06
