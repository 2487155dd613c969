"""What hands look like: surfaces that follow what touches, light enough for pages, and no part of the digest."""

import numpy as np
import pytest
import trimesh

from xdex_drake.hand.human import human_hand
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.looks import COARSE, FINE, FINGER_COLORS, METAL_COLOR, NAIL_COLOR, hand_surfaces, surface_obj
from xdex_drake.hand.yaml_file import hand_digest

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
