"""Mirror images of hands, and other fingertips."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform

from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Capsule
from xdex_drake.hand.fingertip import replace_tip
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.mirror import mirror
from xdex_drake.hand.yaml_file import hand_digest, read_hand, write_hand

FLIP = np.diag([1.0, -1.0, 1.0])


@pytest.mark.parametrize("name", ["allegro", "ability", "shadow"])
def test_kinematics_are_reflected(name) -> None:
    hand, rng = load_hand(name), np.random.default_rng(3)
    other = mirror(hand)
    assert (other.name, other.side) == (f"{name}_left", "left")
    for _ in range(5):
        q = rng.uniform(*hand.limits)
        R, p = forward_kinematics(hand, RigidTransform(), q)
        R_other, p_other = forward_kinematics(other, RigidTransform(), q)
        np.testing.assert_allclose(p_other, p @ FLIP, atol=1e-12)
        np.testing.assert_allclose(R_other, FLIP @ R @ FLIP, atol=1e-12)
    for one, two in zip(hand.links, other.links, strict=True):
        assert two.mass == one.mass
        np.testing.assert_array_equal(two.p_LLcm, FLIP @ one.p_LLcm)
        np.testing.assert_array_equal(np.linalg.eigvalsh(two.I_LLcm) > 0.0, True)
        np.testing.assert_array_equal(two.spheres[:, 1], -one.spheres[:, 1])
    for one, two in zip(hand.fingers, other.fingers, strict=True):
        np.testing.assert_array_equal(two.n_LPad, FLIP @ one.n_LPad)


def test_twice_is_the_hand_itself(tmp_path) -> None:
    hand = load_hand("inspire")
    twice = mirror(mirror(hand))
    assert hand_digest(twice) == hand_digest(hand)
    assert (twice.name, twice.display_name, twice.sources) == (hand.name, hand.display_name, hand.sources)
    write_hand(mirror(hand), tmp_path / "left.yaml")
    assert hand_digest(read_hand(tmp_path / "left.yaml")) == hand_digest(mirror(hand))


def test_ignored_contacts_stay() -> None:
    hand = load_hand("allegro")
    pairs = ((hand.links[0].name, hand.links[-2].name),)
    assert mirror(replace(hand, ignored_contacts=pairs)).ignored_contacts == pairs


def test_a_tip_of_ones_own(tmp_path) -> None:
    hand = load_hand("allegro")
    finger = hand.fingers[1]
    along = finger.p_LTip / np.linalg.norm(finger.p_LTip)
    tip = Capsule(np.zeros(3), 0.03 * along, 0.008)
    changed = replace_tip(hand, finger.name, [tip])
    link = changed.links[changed.link_index[finger.tip_link]]
    assert link.geometry == (tip,)
    assert len(link.spheres) > 0
    assert link.mass == pytest.approx(1100.0 * (np.pi * 0.008**2 * 0.03 + 4.0 / 3.0 * np.pi * 0.008**3))
    new = next(f for f in changed.fingers if f.name == finger.name)
    old_reach = max(float(s[:3] @ along + s[3]) for s in hand.links[hand.link_index[finger.tip_link]].spheres)
    assert new.p_LTip @ along - finger.p_LTip @ along == pytest.approx(0.038 - old_reach, abs=2e-3)
    assert changed.links[0] is hand.links[0]


def test_a_tip_from_a_mesh_file(tmp_path) -> None:
    hand = load_hand("allegro")
    trimesh.creation.icosphere(radius=12.0).export(tmp_path / "tip.stl")
    changed = replace_tip(hand, "thumb", tmp_path / "tip.stl", scale=1e-3, p_LM=np.array([0.0, 0.0, 0.03]), mass=0.01)
    link = changed.links[changed.link_index[changed.fingers[0].tip_link]]
    assert link.mass == 0.01
    np.testing.assert_allclose(link.p_LLcm, [0.0, 0.0, 0.03], atol=1e-4)
    assert link.spheres[:, :3].mean(axis=0) == pytest.approx([0.0, 0.0, 0.03], abs=2e-3)


def test_refused_tips(tmp_path) -> None:
    hand = load_hand("allegro")
    with pytest.raises(HandFileError, match="name one of thumb"):
        replace_tip(hand, "toe", [])
    with pytest.raises(HandFileError, match="no shape"):
        replace_tip(hand, "thumb", [])
    with pytest.raises(HandFileError, match="does not exist"):
        replace_tip(hand, "thumb", tmp_path / "absent.stl")
