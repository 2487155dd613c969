import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.grasp import Certificate, Contact, Grasp
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="session")
def hand():
    return load_hand("allegro")


@pytest.fixture(scope="session")
def scene():
    return make_scene(load_object("can"))


@pytest.fixture(scope="session")
def grasp(hand, scene):
    """A hand that hangs beside the can without touching it: it needs no search, and its lift fails."""
    # Fingers downward, palm toward the can.
    p_WO = scene.X_WO.translation()
    X_WH = RigidTransform(
        RotationMatrix(np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])), p_WO + np.array([-0.2, 0, 0.26])
    )
    vertices = scene.object.vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = 0.5 * (low + high)
    contacts = tuple(
        Contact(hand.fingers[k].tip_link, np.array([x, middle[1], middle[2]]), n, 0.6, np.array([0.1, 0.0, 1.0]))
        for k, (x, n) in enumerate([(low[0], np.array([1.0, 0, 0])), (high[0], np.array([-1.0, 0, 0]))])
    )
    certificate = Certificate(
        contacts, scene.X_WO.rotation().matrix(), scene.object.p_OOcm, 0.1, 0.05, 1e-9, 1.25, 0.125, 0.126
    )
    q = hand.q_rest
    return Grasp(
        hand="allegro",
        object="can",
        X_WO=scene.X_WO,
        X_WH=X_WH,
        q=q,
        certificate=certificate,
        X_WH_pregrasp=X_WH,
        q_pregrasp=q,
        q_squeeze=q,
        tau_squeeze=np.zeros_like(q),
        grasp_id="allegro-can-0",
        penetration_parts_m=2.5e-4,
        penetration_mesh_m=3e-4,
    )
