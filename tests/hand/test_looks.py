"""What hands look like: surfaces that follow what touches, light enough for pages, and no part of the digest."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from xdex_drake.errors import HandFileError
from xdex_drake.hand.human import human_hand
from xdex_drake.hand.importing.files import import_hand
from xdex_drake.hand.importing.painted import lighter
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.looks import COARSE, FINE, FINGER_COLORS, METAL_COLOR, NAIL_COLOR, hand_surfaces, surface_obj
from xdex_drake.hand.mirror import mirror
from xdex_drake.hand.variation import scale_hand
from xdex_drake.hand.yaml_file import hand_digest, read_hand, surfaces_file, write_hand
from xdex_drake.interchange.urdf import export_urdf

NAMES = [*list_hands(), "human", "g0-0000", "g0-0002", "g0-0007"]


def hand_of(name):
    return human_hand() if name == "human" else load_hand(name)


@pytest.mark.parametrize("name", NAMES)
def test_surfaces_are_closed_light_and_near_what_touches(name: str) -> None:
    hand = hand_of(name)
    before = hand_digest(hand)
    for detail, most in ((FINE, 20_000), (COARSE, 7_000)):
        surfaces = hand_surfaces(hand, detail)
        assert len(surfaces) == len(hand.links)
        assert sum(len(s.faces) for link in surfaces for s in link) < most
    for link, drawn in zip(hand.links, hand_surfaces(hand), strict=True):
        for surface in drawn:
            np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-6)
            assert surface.faces.max() < len(surface.vertices)
            mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=True)
            assert mesh.volume > 0.0  # faces are seen from outside
        if not link.geometry:
            continue
        # What an object can touch is where it is drawn: nearly no corner of the body lies far from the primitives.
        body = drawn[0] if len(drawn) else None
        assert body is not None
        distance = np.min([shape.signed_distance(body.vertices) for shape in link.geometry], axis=0)
        assert distance.max() < 4e-3, link.name
        if sum(surface.color == body.color for surface in drawn) == 1:
            assert np.quantile(-distance, 0.9) < 2.5e-3, link.name
    assert hand_digest(hand) == before


def test_fingers_are_told_by_their_pads_and_people_have_nails() -> None:
    robot = load_hand("allegro")
    surfaces = hand_surfaces(robot)
    for finger in robot.fingers:
        tip = robot.link_index[finger.tip_link]
        pads = [s for s in surfaces[tip] if s.color == FINGER_COLORS[finger.name]]
        assert len(pads) == 1
        # It stands out of the pad's side.
        assert ((pads[0].vertices - finger.p_LTip) @ finger.n_LPad).max() > 0.0
    assert any(s.color == METAL_COLOR for link in surfaces for s in link)
    person = human_hand()
    colors = [s.color for link in hand_surfaces(person) for s in link]
    assert colors.count(NAIL_COLOR) == 5
    assert METAL_COLOR not in colors


def test_an_obj_file_holds_the_surfaces() -> None:
    surfaces = hand_surfaces(load_hand("inspire"), COARSE)[0]
    text = surface_obj(surfaces)
    mesh = trimesh.load(trimesh.util.wrap_as_stream(text), file_type="obj", process=False, force="mesh")
    assert len(mesh.faces) == sum(len(s.faces) for s in surfaces)
    np.testing.assert_allclose(mesh.bounds[0], np.min([s.vertices.min(axis=0) for s in surfaces], axis=0), atol=1e-5)


@pytest.fixture(scope="module")
def painted(tmp_path_factory):
    """A hand from a URDF file whose palm is drawn by a red mesh of many triangles, and the file's folder."""
    folder = tmp_path_factory.mktemp("painted")
    file = export_urdf(load_hand("inspire"), folder)
    tree = ElementTree.parse(file)
    link = next(k for k in tree.getroot().iter("link") if k.get("name") == load_hand("inspire").links[0].name)
    palm = trimesh.creation.icosphere(subdivisions=5, radius=0.03)
    palm.export(folder / "meshes" / "palm.stl") if (folder / "meshes").is_dir() else palm.export(folder / "palm.stl")
    name = "meshes/palm.stl" if (folder / "meshes").is_dir() else "palm.stl"
    for visual in link.findall("visual"):
        link.remove(visual)
    link.append(
        ElementTree.fromstring(
            f'<visual><origin xyz="0 0 0.05"/><geometry><mesh filename="{name}"/></geometry>'
            '<material name="red"/></visual>'
        )
    )
    tree.getroot().append(ElementTree.fromstring('<material name="red"><color rgba="0.9 0.1 0.2 1"/></material>'))
    tree.write(file)
    return import_hand(file).hand


def test_an_imported_hand_keeps_its_meshes_and_colors(painted, tmp_path) -> None:
    palm = painted.links[0]
    (surface,) = palm.surfaces
    assert surface.color == (0.9, 0.1, 0.2)
    assert 500 < len(surface.faces) <= 2500
    np.testing.assert_allclose(np.linalg.norm(surface.vertices - [0.0, 0.0, 0.05], axis=1), 0.03, atol=6e-4)
    assert hand_surfaces(painted)[0] == palm.surfaces
    # Looks are no part of what a hand is.
    bare = replace(painted, links=tuple(replace(link, surfaces=()) for link in painted.links))
    assert hand_digest(bare) == hand_digest(painted)
    # They lie beside the description, and come back with it.
    file = tmp_path / "mine.yaml"
    write_hand(painted, file)
    back = read_hand(file)
    assert hand_digest(back) == hand_digest(painted)
    again = back.links[0].surfaces[0]
    assert again.color == pytest.approx(surface.color, abs=0.003)
    np.testing.assert_allclose(again.vertices, surface.vertices, atol=1e-6)
    np.testing.assert_array_equal(again.faces, surface.faces)
    other = mirror(painted).links[0].surfaces[0]
    np.testing.assert_allclose(other.vertices[:, 1], -surface.vertices[:, 1])
    # What is scaled no longer looks like its file.
    assert not scale_hand(painted, 1.1).links[0].surfaces
    # They leave again with the description.
    text = export_urdf(painted, tmp_path / "out").read_text()
    assert "0.9 0.1 0.2 1" in text and (tmp_path / "out" / "meshes").is_dir()
    # A hand without looks leaves none of another's behind.
    write_hand(bare, file)
    assert not surfaces_file(file).exists()


def test_a_broken_file_of_looks_is_told(painted, tmp_path) -> None:
    file = tmp_path / "mine.yaml"
    write_hand(painted, file)
    surfaces_file(file).write_bytes(b"glTF" + bytes(30))
    with pytest.raises(HandFileError, match=r"looks\.glb.*remove"):
        read_hand(file)


def test_a_heavy_mesh_becomes_light_and_stays_where_it_is() -> None:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.02)
    vertices, faces = lighter(np.asarray(ball.vertices), np.asarray(ball.faces), most=1500)
    assert 300 < len(faces) <= 1500
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.02).max() < 3e-4
