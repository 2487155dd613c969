"""Grasps, hands and scenes that do not belong together are refused by name; nothing prints thousands of numbers."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Certificate, Contact, Grasp
from xdex_drake.grasping.finish import finish_grasp
from xdex_drake.grasping.synthesis import synthesize
from xdex_drake.hand.library import load_hand
from xdex_drake.programs.force_closure import force_closure_program
from xdex_drake.programs.retargeting import retargeting_program
from xdex_drake.programs.search import SearchSettings, search
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.drake import lift
from xdex_drake.visualization.replay import grasp_page, record_lift


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro")


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("can"))


@pytest.fixture(scope="module")
def grasp(allegro, scene):
    """A grasp by its facts alone; nothing here goes on to simulate it."""
    q, X_WH = allegro.q_rest, RigidTransform([0.0, 0.0, 0.3])
    return Grasp("allegro", "can", scene.X_WO, X_WH, q, None, X_WH, q, q, 0.0 * q, grasp_id="g1")


def _elsewhere(scene):
    return make_scene(scene.object, pose=RigidTransform(scene.X_WO.rotation(), [0.1, 0.0, 0.0]))


@pytest.mark.parametrize("use", [lift, record_lift, lambda g, h, s: grasp_page([g], [h], [s])])
def test_what_does_not_belong_together_is_refused(use, grasp, allegro, scene):
    shadow, box = load_hand("shadow"), make_scene(load_object("box"))
    for wrong, said in (
        ((grasp, shadow, scene), "g1 is of hand 'allegro', not of 'shadow'"),
        ((grasp, allegro, box), "of object 'can', the scene holds 'box'"),
        ((grasp, allegro, _elsewhere(scene)), "at another pose"),
        ((replace(grasp, q=grasp.q[:5]), allegro, scene), "q has 5 values, allegro has 16"),
        ((replace(grasp, certificate=_touching("nail")), allegro, scene), "'nail', no link of allegro"),
    ):
        with pytest.raises(ConfigError, match=said):
            use(*wrong)


def _touching(link):
    contact = Contact(link, np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.6, np.array([0.0, 0.0, 1.0]))
    return Certificate((contact,), np.eye(3), np.zeros(3), 0.1, 0.05, 0.0, 1.0, 0.0, 0.0)


def test_a_grasp_without_squeeze_is_not_lifted(grasp, allegro, scene):
    with pytest.raises(ConfigError, match="no pre-grasp or squeeze"):
        lift(replace(grasp, tau_squeeze=None), allegro, scene)


def test_programs_and_their_ends_ask_for_their_own_hand(grasp, allegro, scene):
    shadow = load_hand("shadow")
    with pytest.raises(ConfigError, match="not of 'shadow'"):
        retargeting_program(grasp, shadow, allegro, scene)
    program = force_closure_program(allegro, scene, starts=1, search_settings=SearchSettings(iterations=2))
    with pytest.raises(ConfigError, match="not of 'shadow'"):
        finish_grasp(shadow, program.start)
    candidates = search(allegro, scene, count=2, settings=SearchSettings(iterations=2))
    for value in (allegro, scene, scene.object, grasp, replace(grasp, certificate=_touching("nail")), candidates):
        assert len(repr(value)) < 300 and "\n" not in repr(value)
        assert repr(value).startswith(type(value).__name__)
    assert "allegro" in repr(program) and len(repr(program)) < 300
    assert len(str(allegro)) < 300


def test_nothing_is_asked_for_nothing(allegro, scene):
    with pytest.raises(ConfigError, match="count is 0"):
        next(synthesize(allegro, scene, count=0))
    with pytest.raises(ConfigError, match="search of 0 starts"):
        force_closure_program(allegro, scene, starts=0)
    with pytest.raises(ConfigError, match="contacts is 0"):
        force_closure_program(allegro, scene, contacts=0)
    with pytest.raises(ConfigError, match=r"grasp_type is 'hook'.*pinch"):
        force_closure_program(allegro, scene, grasp_type="hook")
    with pytest.raises(ConfigError, match="spread is -1 m"):
        SearchSettings(spread=-1.0)
