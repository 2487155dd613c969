"""Spheres cover their geometry and hardly bulge; mass properties agree with closed forms and with sampling."""

import numpy as np
import pytest
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Box, Capsule, Convex, Hand, Sphere
from xdex_drake.hand.human import human_hand
from xdex_drake.hand.importing.interpret import interpret
from xdex_drake.hand.importing.model import FileJoint, FileLink, FileModel, TriangleMesh
from xdex_drake.hand.inertia import DENSITY, ROTOR_INERTIA, link_inertia
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.spheres import BULGE, SCALLOP, fit_spheres


def gap(spheres: Array, points: Array) -> Array:
    return (np.linalg.norm(points[:, None] - spheres[None, :, :3], axis=-1) - spheres[:, 3]).min(axis=1)


def test_capsule_spheres_follow_the_axis() -> None:
    capsule = Capsule(np.array([0.0, 0.0, 0.01]), np.array([0.02, 0.0, 0.03]), 0.008)
    spheres = fit_spheres((capsule,))
    assert spheres[0, :3] == pytest.approx(capsule.p0)
    assert spheres[-1, :3] == pytest.approx(capsule.p1)
    assert (spheres[:, 3] == 0.008).all()
    assert gap(spheres, capsule.sample(4000, np.random.default_rng(0))).max() <= SCALLOP + 1e-9


def test_degenerate_capsule_is_one_sphere() -> None:
    spheres = fit_spheres((Capsule(np.ones(3), np.ones(3), 0.01),))
    assert spheres == pytest.approx(np.array([[1.0, 1.0, 1.0, 0.01]]))


def test_no_geometry_no_spheres() -> None:
    assert fit_spheres(()).shape == (0, 4)


def test_spheres_are_the_same_each_time() -> None:
    box = Box(np.array([0.03, 0.05, 0.07]), np.zeros(3))
    assert np.array_equal(fit_spheres((box,)), fit_spheres((box,)))


def imported_hand() -> Hand:
    """Two jaws on a palm whose boxes, hull and capsule overlap, as a file might have it."""
    wedge = np.array([[x, y, z] for x in (-0.02, 0.02) for y, z in ((-0.04, 0.03), (0.04, 0.03), (0.0, 0.075))])
    corners = np.array([*wedge, [0.0, 0.0, 0.08]])
    hull = TriangleMesh(corners, ConvexHull(corners).simplices.astype(np.int64))
    boxes = [Box(np.array([0.03, 0.12, 0.04]), np.array([x, 0.0, 0.02])) for x in (-0.012, 0.012)]
    handle = Capsule(np.array([0.0, 0.0, -0.03]), np.zeros(3), 0.02)
    links, joints = [FileLink("palm", (), (*boxes, hull, handle))], []
    for name, sign in (("a", 1.0), ("b", -1.0)):
        pad = Box(np.array([0.02, 0.012, 0.06]), np.array([0.0, 0.006 * sign, 0.03]))
        links.append(FileLink(name, (), (pad,)))
        p, axis = np.array([0.0, 0.005 * sign, 0.085]), np.array([0.0, sign, 0.0])
        joints.append(FileJoint(f"to_{name}", "prismatic", "palm", name, p, np.eye(3), axis, 0.0, 0.04, 50.0))
    return interpret(FileModel("made", "made.urdf", tuple(links), tuple(joints)), name="made").hand


@pytest.mark.parametrize("name", [*list_hands(), "human", "imported"])
def test_spheres_cover_each_link_and_hardly_bulge(name) -> None:
    rng = np.random.default_rng(0)
    makers = {"human": human_hand, "imported": imported_hand}
    hand = makers[name]() if name in makers else load_hand(name)
    for link in hand.links:
        covered = []
        for shape in link.geometry:
            points = shape.sample(1500, rng)
            # Points within another shape of the link need no cover.
            others = [other for other in link.geometry if other is not shape]
            for other in others:
                points = points[other.signed_distance(points) > 0.0]
            distances = gap(link.spheres, points)
            if isinstance(shape, Capsule | Sphere):
                assert distances.max(initial=0.0) < 1e-3, link.name
            covered.append(distances < 3e-3)
        if covered:
            assert np.concatenate(covered).mean() >= 0.95, link.name
        for x, y, z, r in link.spheres:
            around = Sphere(np.array([x, y, z]), r).sample(300, rng)
            outside = np.min([shape.signed_distance(around) for shape in link.geometry], axis=0)
            # Spheres that span several parts are checked on many directions, not on all.
            assert outside.max() <= (3e-3 if name == "imported" else BULGE + 1e-9), link.name


def test_a_link_of_many_parts_needs_no_more_spheres_than_its_parts() -> None:
    plates = tuple(Box(np.array([0.02, 0.04, 0.06]), np.array([0.0, y, 0.0])) for y in (-0.035, 0.0, 0.035))
    together = fit_spheres(plates)
    assert 8 <= len(together) < sum(len(fit_spheres((plate,))) for plate in plates)
    whole = Box(np.array([0.02, 0.11, 0.06]), np.zeros(3))
    assert (gap(together, whole.sample(4000, np.random.default_rng(0))) < 3e-3).mean() > 0.95


def test_hull_is_covered_like_a_box() -> None:
    box = Box(np.array([0.03, 0.05, 0.07]), np.array([0.01, 0.0, 0.0]))
    hull = Convex(box.corners())
    distances = gap(fit_spheres((hull,)), hull.sample(4000, np.random.default_rng(0)))
    assert (distances < 3e-3).mean() > 0.95


def test_capsule_inertia_agrees_with_drake() -> None:
    u = np.array([0.6, 0.0, 0.8])
    capsule = Capsule(np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.2, 0.3]) + 0.04 * u, 0.01)
    mass, p_LLcm, I_LLcm = link_inertia((capsule,), 0.05)
    expected = SpatialInertia.SolidCapsuleWithMass(0.05, 0.01, 0.04, u).CalcRotationalInertia().CopyToFullMatrix3()
    assert mass == 0.05
    assert p_LLcm == pytest.approx(capsule.p0 + 0.02 * u)
    assert I_LLcm - ROTOR_INERTIA * np.eye(3) == pytest.approx(expected, rel=1e-9)


def test_box_and_hull_inertia_agree() -> None:
    R = Rotation.from_rotvec([0.4, -0.2, 0.9]).as_matrix()
    box = Box(np.array([0.02, 0.03, 0.05]), np.array([0.1, 0.0, -0.1]), R)
    hull = Convex(box.corners())
    a, b = link_inertia((box,)), link_inertia((hull,))
    assert a[0] == pytest.approx(DENSITY * 0.02 * 0.03 * 0.05)
    assert b[0] == pytest.approx(a[0])
    assert b[1] == pytest.approx(a[1])
    assert b[2] == pytest.approx(a[2], rel=1e-9)
    unit = UnitInertia.SolidBox(0.02, 0.03, 0.05).CopyToFullMatrix3()
    assert a[2] - ROTOR_INERTIA * np.eye(3) == pytest.approx(a[0] * R @ unit @ R.T, rel=1e-9)


def test_two_balls_are_a_dumbbell() -> None:
    balls = tuple(Sphere(np.array([x, 0.0, 0.0]), 0.01) for x in (-0.1, 0.1))
    mass, p_LLcm, I_LLcm = link_inertia(balls, 1.0)
    own = 0.4 * 0.01**2
    assert p_LLcm == pytest.approx(np.zeros(3), abs=1e-15)
    assert np.diag(I_LLcm) - ROTOR_INERTIA == pytest.approx([own, own + 0.01, own + 0.01])
    assert mass == 1.0


def test_a_hub_has_mass_and_inertia() -> None:
    mass, p_LLcm, I_LLcm = link_inertia(())
    assert mass > 0.0
    assert (p_LLcm == 0.0).all()
    assert np.linalg.eigvalsh(I_LLcm).min() > ROTOR_INERTIA
