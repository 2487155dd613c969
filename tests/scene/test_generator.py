import hashlib

import numpy as np
import pytest
import trimesh

from xdex_drake.errors import UnknownObject
from xdex_drake.scene.generator import (
    FAMILIES,
    GRASPABLE,
    LONGEST,
    MIN_HEIGHT,
    family_name,
    generated_mesh,
    is_shape_name,
    shape_name,
)
from xdex_drake.scene.object import load_object


@pytest.fixture(scope="module")
def shapes():
    return {shape_name(0, k): generated_mesh(shape_name(0, k)) for k in range(200)}


def test_two_hundred_shapes_are_closed_in_one_piece_and_graspable(shapes):
    for name, (vertices, faces) in shapes.items():
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        extents = np.ptp(vertices, axis=0)
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 1e-5, name
        assert mesh.body_count == 1, name
        assert ((extents >= GRASPABLE[0]) & (extents <= GRASPABLE[1])).any(), name
        assert extents[2] >= MIN_HEIGHT and extents.max() <= LONGEST + 1e-6, name
        assert vertices[:, 2].min() == 0.0, name


def test_shapes_differ(shapes):
    digests = {hashlib.sha256(vertices.tobytes()).hexdigest() for vertices, _ in shapes.values()}
    assert len(digests) == len(shapes)
    assert {family_name(name) for name in shapes} == set(FAMILIES)
    signature = np.array(
        [
            [*np.sort(np.ptp(v, axis=0)), trimesh.Trimesh(v, f, process=False).volume ** (1.0 / 3.0)]
            for v, f in shapes.values()
        ]
    )
    gap = np.linalg.norm(signature[:, None] - signature, axis=2) + np.eye(len(signature))
    assert gap.min() > 1e-4


def test_a_shape_depends_on_its_name_alone(shapes):
    name = shape_name(0, 137)
    again = generated_mesh(name)
    np.testing.assert_array_equal(again[0], shapes[name][0])
    np.testing.assert_array_equal(again[1], shapes[name][1])
    other = generated_mesh(shape_name(1, 137))
    assert other[0].shape != again[0].shape or (other[0] != again[0]).any()


def test_names():
    assert shape_name(3, 42) == "s3-0042" and is_shape_name("s3-0042") and is_shape_name("s0-12345")
    for wrong in ("s3-42", "s-0042", "shape", "s3-0042.obj", "g0-0137"):
        assert not is_shape_name(wrong)
        with pytest.raises(KeyError):
            generated_mesh(wrong)


def test_a_generated_shape_is_an_object_without_a_file():
    model = load_object("s0-0003")
    assert model.name == "s0-0003" and model.path is None and model.report.watertight
    assert model.report.bulge_p99_m < 1e-3
    with pytest.raises(UnknownObject):
        load_object("s0-3")
