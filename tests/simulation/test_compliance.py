"""The stiffness of a grasp under load against differences of a simulated one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import xdex_drake.hand.plant as hand_plant
from xdex_drake.contact.stiffness import response
from xdex_drake.contact.wrench import GRAVITY
from xdex_drake.grasping.passive import elastic_grasp
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.drake import LiftRig, lift_rig, simulate_lift

PUSH = 0.2
"""Force of a push [m g]: nothing slides."""

STIFF = 80.0
"""Softer grasps than this move so far that they are not linear any more [N/m]."""


@pytest.fixture
def rig(monkeypatch):
    # The facets that round tips have in contact roll in steps of ten degrees: too small a push does not take one.
    monkeypatch.setattr(hand_plant, "contact_shape", hand_plant.drake_shape)
    return lift_rig(load_hand("allegro"), make_scene(load_object("box")))


def displacements(rig: LiftRig) -> np.ndarray:
    """Half the twists between pushes along + and - each axis, at the end of a lift, as columns, shape (6, 3)."""
    kept, p_OOcm = rig.state(), rig.scene.object.p_OOcm
    step, force = rig.protocol.plant.time_step, PUSH * rig.scene.object.mass * GRAVITY

    def pushed(direction):
        rig.restore(kept)
        for k in range(1, 21):
            rig.push(k / 20.0 * force * direction)
            rig.advance_to(kept[0] + k * step)
        rig.advance_to(kept[0] + 100 * step)
        X_WO = rig.X_WO()
        rig.push(np.zeros(3))
        return X_WO

    columns = []
    for axis in np.eye(3):
        plus, minus = pushed(axis), pushed(-axis)
        turn = Rotation.from_matrix((plus.rotation() @ minus.rotation().inverse()).matrix()).as_rotvec()
        columns.append(0.5 * np.concatenate([turn, plus @ p_OOcm - minus @ p_OOcm]))
    return np.array(columns).T


def test_a_simulated_grasp_is_as_compliant_as_its_stiffness_says(rig):
    """Within a tenth, where joints give way everywhere; without the load's terms it is off by more."""
    hand, scene = rig.hand, rig.scene
    settings = replace(SynthesisSettings(), batch=64)
    pushes = np.hstack([np.zeros((3, 3)), PUSH * scene.object.mass * GRAVITY * np.eye(3)])
    length = np.array([scene.object.length] * 3 + [1.0] * 3)
    loaded, unloaded = [], []
    for grasp in candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally()):
        assert grasp.certificate is not None
        elastic = elastic_grasp(hand, Configuration.at(hand, grasp.X_WH, grasp.q), scene, grasp.certificate, 1.0)
        f = np.array([contact.f_C for contact in grasp.certificate.contacts]).ravel()
        K_x = elastic.stiffness.object_stiffness(f) / np.outer(length, length)
        if np.linalg.eigvalsh(0.5 * (K_x + K_x.T))[0] < STIFF or not simulate_lift(rig, grasp).success:
            continue
        x = length[:, None] * displacements(rig)
        for errors, forces in ((loaded, f), (unloaded, 0.0 * f)):
            expected = length[:, None] * response(elastic.stiffness, forces, pushes).x
            errors.append(float(np.linalg.norm(x - expected) / np.linalg.norm(x)))
        if len(loaded) == 3:
            break
    assert len(loaded) >= 2
    assert max(loaded) < 0.1, loaded
    assert all(a < b for a, b in zip(loaded, unloaded, strict=True))
