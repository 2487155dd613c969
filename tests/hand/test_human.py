"""Human hands: MANO's tree, people's sizes, and postures that hands can take."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.hand.checks import check_hand, check_in_drake, hand_size
from xdex_drake.hand.collision import ignored_pairs
from xdex_drake.hand.description import Hand
from xdex_drake.hand.human import MEAN_SHAPE, NINETY_EIGHT, SURVEY, human_hand, sample_shape
from xdex_drake.hand.kinematics import Configuration, forward_kinematics
from xdex_drake.hand.yaml_file import hand_digest, read_hand, write_hand


@pytest.fixture(scope="module")
def people() -> list:
    rng = np.random.default_rng(3)
    return [sample_shape(rng) for _ in range(200)]


@pytest.fixture(scope="module")
def hands(people) -> list[Hand]:
    return [human_hand(shape) for shape in people[:12]]


def tips(hand: Hand, q: np.ndarray) -> tuple[dict, dict]:
    k = Configuration.at(hand, RigidTransform(), q)
    links = np.array([hand.link_index[finger.tip_link] for finger in hand.fingers])
    points = k.points(links, np.array([finger.p_LTip for finger in hand.fingers]))
    pads = k.vectors(links, np.array([finger.n_LPad for finger in hand.fingers]))
    names = [finger.name for finger in hand.fingers]
    return dict(zip(names, points, strict=True)), dict(zip(names, pads, strict=True))


def test_has_manos_tree() -> None:
    hand = human_hand()
    solid = [link.name for link in hand.links if link.geometry]
    assert len(solid) == 16  # the wrist's body and three for each digit
    assert len(hand.joint_names) == 20
    assert all(joint.coupling is None for joint in hand.joints)
    assert [finger.name for finger in hand.fingers] == ["thumb", "index", "middle", "ring", "little"]
    for finger in hand.fingers:
        assert len(finger.links) == 4  # a hub and three segments


def test_two_hundred_people_are_within_the_survey(people) -> None:
    for shape in people:
        values = 1e3 * np.array([shape.hand_length, shape.palm_length, shape.hand_breadth])
        fits = []
        for mean, covariance in SURVEY.values():
            z = (values - np.array(mean[:3])) / np.sqrt(np.diag(covariance)[:3])
            fits.append(np.abs(z).max() < NINETY_EIGHT + 0.02)
        assert any(fits)
        assert 0.8 < shape.thickness < 1.25
    lengths = np.array([shape.hand_length for shape in people])
    # Men and women in equal parts: between the two means, and both spreads.
    assert 0.184 < lengths.mean() < 0.191
    assert 0.009 < lengths.std() < 0.014
    assert len({shape.segments for shape in people}) == 200


def test_the_survey_is_the_reference(reference) -> None:
    import json

    stats = json.loads((reference / "hands_reference" / "human_hand_stats.json").read_text())["ansur_ii"]
    for ours, theirs in (("man", "male"), ("woman", "female")):
        mean, covariance = SURVEY[ours]
        assert list(mean) == pytest.approx(stats[theirs]["mean"][:5], abs=0.006)
        assert np.array(covariance) == pytest.approx(np.array(stats[theirs]["covariance"])[:5, :5], abs=0.006)


def test_measures_what_its_shape_says(people) -> None:
    for shape in people[:12]:
        hand = human_hand(shape)
        points, _ = tips(hand, np.zeros(20))
        # The middle finger leans by half a degree, and its knuckle lies behind the plane of the wrist.
        assert points["middle"][2] == pytest.approx(shape.hand_length, abs=1e-4)
        assert hand_size(hand) == pytest.approx(shape.hand_length, rel=0.02)
        _, p = forward_kinematics(hand, RigidTransform(), np.zeros(20))
        radius = {name: hand.links[hand.link_index[f"{name}_proximal"]].spheres[0, 3] for name in ("index", "little")}
        knuckles = [p[hand.link_index[f"{name}_proximal"]][1] for name in ("index", "little")]
        breadth = knuckles[0] - knuckles[1] + sum(radius.values())
        # Without the flesh beside the bones.
        assert 0.8 * shape.hand_breadth < breadth < 1.02 * shape.hand_breadth


def test_is_sound(hands) -> None:
    for hand in hands:
        assert check_hand(hand) == ()
        assert 0.25 < sum(link.mass for link in hand.links) < 0.75
        assert check_hand(human_hand(MEAN_SHAPE)) == ()
    assert check_in_drake(hands[0], seconds=0.2) == ()


def test_only_neighbors_overlap_at_rest(hands) -> None:
    for hand in hands:
        for i, j in ignored_pairs(hand):
            above = int(hand.parents[j])
            while above > 0 and not hand.links[above].geometry:
                above = int(hand.parents[above])
            assert above == i, (hand.links[i].name, hand.links[j].name)


def test_at_rest_the_thumb_opposes_the_fingers(hands) -> None:
    for hand in hands:
        points, pads = tips(hand, hand.q_rest)
        for name in ("index", "middle"):
            across = points[name] - points["thumb"]
            distance = np.linalg.norm(across)
            assert 0.035 < distance < 0.075, name
            assert pads[name] @ -across > 0.6 * distance, name
            assert pads["thumb"] @ across > 0.4 * distance, name
        assert all(point[0] > 0.03 for point in points.values())


def test_flexion_bends_toward_the_palm() -> None:
    hand = human_hand()
    for k, joint in enumerate(hand.joints):
        if "abduction" in joint.name or "thumb" in joint.name:
            continue
        finger = joint.name.split("_")[0]
        q = np.zeros(20)
        q[k] = 0.2
        assert tips(hand, q)[0][finger][0] > tips(hand, np.zeros(20))[0][finger][0] + 1e-3, joint.name


def test_round_trip(hands, tmp_path) -> None:
    write_hand(hands[0], tmp_path / "human.yaml")
    assert hand_digest(read_hand(tmp_path / "human.yaml")) == hand_digest(hands[0])
