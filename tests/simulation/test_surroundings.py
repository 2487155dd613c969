"""Grasps beside obstacles, and of objects that float."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.dataset.files import load_grasps, save_grasps
from xdex_drake.errors import ConfigError
from xdex_drake.grasping.synthesis import SynthesisSettings, synthesize
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.programs.search import SearchSettings
from xdex_drake.programs.terms.surroundings import obstacle_gap
from xdex_drake.scene.fixtures import Fixture
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.drake import lift
from xdex_drake.simulation.protocol import LIFT, RELEASE


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


def test_a_grasp_beside_a_wall_lifts_and_is_stored_with_it(hand, tmp_path):
    wall = Fixture(load_object("0.02x0.3x0.25"), RigidTransform([0.075, 0.0, 0.7]))
    scene = make_scene(load_object("can"), table=0.7, obstacles=[wall])
    settings = SynthesisSettings(batch=40)
    grasp = next(g for g in synthesize(hand, scene, count=1, settings=settings, time_limit_s=600.0) if g.lift.success)
    for X_WH, q in ((grasp.X_WH, grasp.q), (grasp.X_WH_pregrasp, grasp.q_pregrasp)):
        assert obstacle_gap(Configuration.at(hand, X_WH, q), scene) >= 0.0
    save_grasps(tmp_path / "wall.parquet", [grasp], hand, scene)
    (stored,) = load_grasps(tmp_path / "wall.parquet")
    assert stored.scene.table == 0.7 and stored.scene.obstacles[0].object.digest == wall.object.digest
    assert lift(stored.grasp, hand, stored.scene).success
    # The same grasp where the wall stands in the hand's place.
    blocked = replace(scene, obstacles=(Fixture(wall.object, RigidTransform(grasp.X_WH.translation())),))
    assert lift(grasp, hand, blocked).failure_reason == "obstacle_collision"


def test_a_floating_object_is_held_from_below_and_falls_where_nothing_squeezes(hand):
    scene = make_scene(load_object("can"), table=None)
    settings = SynthesisSettings(search=SearchSettings(approach=(0.0, 0.0, 1.0)), batch=40)
    found = synthesize(hand, scene, count=1, settings=settings, time_limit_s=600.0)
    grasp = next(g for g in found if g.lift.success)
    assert grasp.lift.protocol == RELEASE.name and abs(grasp.lift.lift_height_m) < 0.02 and "is held" in repr(grasp)
    assert grasp.X_WH.translation()[2] < (scene.X_WO @ scene.object.p_OOcm)[2]
    loose = lift(replace(grasp, q=grasp.q_pregrasp, tau_squeeze=np.zeros_like(grasp.q)), hand, scene)
    assert not loose.success and loose.lift_height_m < -0.02
    with pytest.raises(ConfigError, match="use protocol release"):
        lift(grasp, hand, scene, protocol=LIFT)
    pytest.importorskip("mujoco", reason="mujoco is not installed")
    from xdex_drake.simulation.mujoco import lift as lift_in_mujoco

    assert lift_in_mujoco(grasp, hand, scene).success
