"""A small hand and rows of its grasps."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.contact.certificate import certify
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.dataset.schema import ObjectFacts, row_from_grasp
from xdex_drake.grasp import Grasp, Hold, Lift
from xdex_drake.hand.description import Coupling, Finger, Hand, Joint, Link
from xdex_drake.hand.yaml_file import hand_digest

IDENTITY = np.eye(3)


def make_hand():
    """Three joints in a row, the last of which follows the second."""
    links = tuple(Link(f"link{k}", (), 0.1, np.zeros(3), IDENTITY * 1e-4, np.zeros((0, 4))) for k in range(4))
    joints = tuple(
        Joint(
            name=f"joint{k}",
            kind="revolute",
            parent=f"link{k}",
            child=f"link{k + 1}",
            p_PJ=np.array([0.0, 0.0, 0.04]),
            R_PJ=IDENTITY,
            axis=np.array([0.0, 1.0, 0.0]),
            lower=-1.0,
            upper=1.0,
            effort=1.0,
            coupling=Coupling("joint1", 0.5, 0.1) if k == 2 else None,
        )
        for k in range(3)
    )
    finger = Finger("index", tuple(link.name for link in links[1:]), "link3", np.zeros(3), np.array([1.0, 0.0, 0.0]))
    return Hand("tiny", "Tiny", "right", links, joints, (finger,), np.zeros(3), IDENTITY, np.zeros(2), {})


def make_facts(name="mug"):
    return ObjectFacts(name, f"meshes/{name}.obj", "d" * 64, 0.001, 0.1, 0.6, np.array([0.01, 0.0, 0.02]), 0.05)


def make_grasp(rng, *, grasp_id="g0", success=True, source="", object="mug"):
    facts = make_facts(object)
    X_WO = RigidTransform(RollPitchYaw(rng.uniform(-1.5, 1.5, 3)), rng.normal(size=3))
    # Three fingers around the center of mass, level whatever the object's rotation.
    angles, R_OW = rng.uniform(0.0, 0.3) + np.array([0.0, 2.1, 4.2]), X_WO.rotation().matrix().T
    out_W = np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)
    certificate = certify(
        facts.p_OOcm + 0.03 * out_W @ R_OW.T,
        -out_W @ R_OW.T,
        [f"link{k}" for k in range(3)],
        HeldObject(facts.mass, facts.length, facts.p_OOcm, facts.friction, X_WO.rotation().matrix()),
    ).certificate
    assert certificate is not None
    hold = Hold(True, "", 0.001, 0.02) if success else Hold(False, "not_lifted", float("nan"), float("nan"))
    return Grasp(
        hand="tiny",
        object=object,
        X_WO=X_WO,
        X_WH=RigidTransform(RollPitchYaw(rng.uniform(-1.5, 1.5, 3)), rng.normal(size=3)),
        q=rng.uniform(-1.0, 1.0, 2),
        certificate=certificate,
        X_WH_pregrasp=RigidTransform(rng.normal(size=3)),
        q_pregrasp=rng.uniform(-1.0, 1.0, 2),
        q_squeeze=rng.uniform(-1.0, 1.0, 2),
        tau_squeeze=rng.uniform(-1.0, 1.0, 2),
        lift=Lift("hold", success, "" if success else "slipped", 0.25, ("index", "thumb"), 1.5, hold),
        grasp_id=grasp_id,
        source_grasp_id=source,
        penetration_parts_m=0.0003,
        penetration_mesh_m=float("nan"),
        squeeze_margin=1.3,
        seconds=2.0,
    )


def make_row(seed, **options):
    grasp = make_grasp(np.random.default_rng(seed), **{"grasp_id": f"g{seed}", **options})
    return row_from_grasp(
        grasp,
        scene_id="mug/0",
        hand=make_hand(),
        hand_digest=hand_digest(make_hand()),
        object=make_facts(grasp.object),
        gains=(1.0, 0.1),
        object_point_O=np.array([0.0, 0.01, 0.02]),
    )


@pytest.fixture
def tiny_hand():
    return make_hand()


@pytest.fixture(name="make_hand")
def make_hand_fixture():
    return make_hand


@pytest.fixture
def facts():
    return make_facts()


@pytest.fixture(name="make_grasp")
def make_grasp_fixture():
    return make_grasp


@pytest.fixture(name="make_row")
def make_row_fixture():
    return make_row
