"""Tables of another height, no table, and what is fixed beside the object."""

import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError
from xdex_drake.grasping.pregrasp import NO_CONTACTS
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.programs.point import Point
from xdex_drake.programs.search import SearchSettings, search_problem
from xdex_drake.programs.terms.surroundings import Surroundings, obstacle_blocks, obstacle_gap
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.fixtures import Fixture, read_fixture
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="module")
def can():
    return load_object("can")


def test_a_fixture_is_read_as_the_shell_gives_it():
    wall = read_fixture("0.02x0.3x0.2@0.1,0,0.05,90")
    assert np.ptp(wall.object.vertices, axis=0) == pytest.approx([0.02, 0.3, 0.2])
    distance, direction = wall.distances(np.array([[0.1, 0.03, 0.1], [0.1, 0.0, 0.3]]))
    assert distance == pytest.approx([0.02, 0.05], abs=1e-4)  # turned: it is thin along y
    assert direction == pytest.approx(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), abs=1e-6)
    assert (wall.lower_bounds(np.array([[0.1, 0.5, 0.1]])) <= 0.49 + 2e-3).all()


@pytest.mark.parametrize("text", ["can", "can@", "can@1,2", "can@1,2,x", "@1,2,3", "can@1,2,nan", "can@1,2,3,4,5"])
def test_what_is_no_fixture_is_told_how_to_write(text):
    with pytest.raises(ConfigError, match="FILE@x,y,z"):
        read_fixture(text)


def test_a_table_may_be_high_or_missing(can):
    usual, high, none = (make_scene(can, table=table) for table in (0.0, 0.7, None))
    assert usual.scene_id == make_scene(can).scene_id and len({s.scene_id for s in (usual, high, none)}) == 3
    np.testing.assert_allclose(high.X_WO.translation() - usual.X_WO.translation(), [0.0, 0.0, 0.7], atol=1e-12)
    assert (high.floor, none.floor) == (0.7, -np.inf)
    lifted = RigidTransform(usual.X_WO.rotation(), usual.X_WO.translation() + np.array([0.0, 0.0, 0.7]))
    assert make_scene(can, pose=lifted, table=0.7).table == 0.7
    assert make_scene(can, pose=RigidTransform([5.0, 0.0, 9.0]), table=None).table is None
    for wrong in (0.65, 0.75):
        with pytest.raises(ConfigError, match=r"lowest point is 50 mm (above|below) the table.*z = "):
            make_scene(can, pose=lifted, table=wrong)
    with pytest.raises(ConfigError, match="height"):
        make_scene(can, table=float("nan"))


def test_an_obstacle_in_the_object_is_refused(can):
    with pytest.raises(ConfigError, match=r"obstacle box: it is \d+ mm inside of can"):
        make_scene(can, obstacles=[Fixture(load_object("box"), RigidTransform([0.03, 0.0, 0.0]))])


def test_plain_facts_bring_the_scene_back(can):
    wall = Fixture(load_object("0.02x0.3x0.2"), RigidTransform([0.1, 0.0, 0.0]))
    for scene in (make_scene(can, table=None), make_scene(can, table=0.5, obstacles=[wall])):
        again = SceneFacts.of(scene).build()
        assert (again.scene_id, again.table, len(again.obstacles)) == (
            scene.scene_id,
            scene.table,
            len(scene.obstacles),
        )
        for one, other in zip(again.obstacles, scene.obstacles, strict=True):
            assert one.object.digest == other.object.digest and one.X_WF.IsExactlyEqualTo(other.X_WF)


def test_programs_keep_clear_of_obstacles(can):
    hand, wall = load_hand("allegro"), Fixture(load_object("0.02x0.3x0.2"), RigidTransform([0.06, 0.0, 0.0]))
    scene = make_scene(can, obstacles=[wall])
    k = Configuration.at(hand, RigidTransform([0.02, 0.0, 0.12]), hand.q_rest)
    point = Point(k, scene, NO_CONTACTS, np.zeros((0, 3)))
    (block,) = obstacle_blocks(point, 5e-4)
    g, J = block.at(point)
    assert block.violation(point) == pytest.approx(0.5 - 1e3 * obstacle_gap(k, scene)) and block.violation(point) > 1.0
    step = 1e-6 * np.random.default_rng(0).normal(size=point.size)
    change = (block.at(point.moved(step))[0] - block.at(point.moved(-step))[0]) / 2.0
    close = np.abs(J).sum(1) > 0.0  # the others are too far away to matter
    np.testing.assert_allclose(change[close], (J @ step)[close], atol=2e-7)
    assert close.sum() > 5 and (g[~close] > 15.0).all()
    (far,) = obstacle_blocks(
        Point(k.moved(np.array([0, 0, 0, -1.0, 0, 0, *np.zeros(16)])), scene, point.contacts, point.forces), 0.0
    )
    assert len(far.lower) == 0
    assert obstacle_blocks(Point(k, make_scene(can), point.contacts, point.forces), 5e-4) == ()

    class Centers:
        radii, centers_W = hand.spheres[:, 3], point.centers_W

    class Tensors:
        radii, centers_W = torch.tensor(Centers.radii), torch.tensor(np.stack([Centers.centers_W] * 2))

    (term,) = Surroundings.of(scene)
    value, pull = term.evaluate(Centers)
    values, pulls = term.evaluate(Tensors)
    assert values.shape == (2,) and float(values[1]) == pytest.approx(float(value), rel=0.05) and value > 0.01
    apart = np.abs(pulls.centers_W[0].numpy() - pull.centers_W).max(axis=1)
    assert (apart < 0.05).mean() > 0.9  # near the wall's edges a grid's directions differ
    assert [term.name for _, term in search_problem(hand, scene).terms][-1] == "obstacles"


def test_from_below_is_for_objects_without_a_table(can):
    hand, up = load_hand("allegro"), SearchSettings(approach=(0.0, 0.0, 1.0))
    search_problem(hand, make_scene(can, table=None), up)
    with pytest.raises(ConfigError, match="from below the table"):
        search_problem(hand, make_scene(can), up)
