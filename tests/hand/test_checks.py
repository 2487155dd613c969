"""Checks of hands: sound ones pass, and each fault is told."""

import dataclasses

import numpy as np
import pytest

from xdex_drake.hand.checks import FACET_GAP, _at_rest, check_hand, check_in_drake, hand_size, repaired_rest
from xdex_drake.hand.description import Hand
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.plant import contact_shape, drake_shape
from xdex_drake.hand.variation import remove_finger, scale_hand, scale_links


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("ability")


def with_joint(hand: Hand, k: int, **changes: object) -> Hand:
    joints = list(hand.joints)
    joints[k] = dataclasses.replace(joints[k], **changes)
    return dataclasses.replace(hand, joints=tuple(joints))


def with_link(hand: Hand, k: int, **changes: object) -> Hand:
    links = list(hand.links)
    links[k] = dataclasses.replace(links[k], **changes)
    return dataclasses.replace(hand, links=tuple(links))


@pytest.mark.parametrize("name", list_hands())
def test_the_library_is_sound(name) -> None:
    assert check_hand(load_hand(name)) == ()
    assert repaired_rest(load_hand(name)) is load_hand(name)


def test_rests_in_drake(hand) -> None:
    assert check_in_drake(hand, time_step=0.02) == ()


def test_facets_make_no_difference_to_a_hand_that_touches_nothing(hand) -> None:
    drifts = []
    for shape_of in (drake_shape, contact_shape):
        rest = _at_rest(hand, 0.02, shape_of)
        assert not rest.has_links_within(FACET_GAP)
        drifts.append(rest.drift(0.2))
    assert drifts[0] == drifts[1]


def test_links_in_contact_at_rest_are_told(hand) -> None:
    """Two fingers whose shapes press against each other though their spheres do not: a fault that only Drake sees."""
    finger = next(f for f in hand.fingers if f.name == "middle")
    k = hand.link_index[finger.tip_link]
    fat = with_link(hand, k, geometry=scale_links(hand, {finger.tip_link: 2.5}).links[k].geometry)
    assert _at_rest(fat, 0.02, drake_shape).has_links_within(0.0)
    assert check_in_drake(fat, time_step=0.02)[0].startswith("drift:")


def test_faults_are_told(hand) -> None:
    faults = {
        "limits": with_joint(hand, 0, lower=2.0, upper=1.0),
        "numbers": with_joint(hand, 1, p_PJ=np.full(3, np.nan)),
        "inertia": with_link(hand, 2, I_LLcm=np.diag([1e-6, 1e-6, 9e-6])),
        "rest": dataclasses.replace(hand, q_rest=hand.q_rest + 9.0),
        "size": scale_hand(hand, 2.0),
    }
    for reason, broken in faults.items():
        found = check_hand(broken)
        assert found and all(text.startswith(f"{reason}:") for text in found), (reason, found)


def test_a_hand_needs_fingers_that_oppose(hand) -> None:
    assert check_hand(remove_finger(hand, "thumb"))[0].startswith("opposition:")
    few = hand
    for name in ("index", "middle", "ring"):
        few = remove_finger(few, name)
    assert check_hand(few)[0].startswith(("links:", "joints:"))


def test_a_finger_that_cannot_close_is_told(hand) -> None:
    k = next(k for k, joint in enumerate(hand.joints) if joint.child == "little_L1" or joint.child == "pinky_L1")
    name = hand.joints[k].name
    stiff = with_joint(hand, k, lower=-0.1, upper=0.1)
    joints = tuple(
        dataclasses.replace(j, lower=-9.0, upper=9.0) if j.coupling is not None and j.coupling.master == name else j
        for j in stiff.joints
    )
    q_rest = np.where(np.array(hand.joint_names) == name, 0.0, hand.q_rest)
    stiff = dataclasses.replace(stiff, joints=joints, q_rest=q_rest)
    assert any(text.startswith("closing:") for text in check_hand(stiff))


def test_an_overlap_is_told_and_mended() -> None:
    hand = load_hand("allegro")
    # Two fingers spread toward each other as far as they go.
    q = hand.q_rest.copy()
    q[hand.joint_names.index("joint_0.0")] = hand.limits[0, hand.joint_names.index("joint_0.0")]
    q[hand.joint_names.index("joint_4.0")] = hand.limits[1, hand.joint_names.index("joint_4.0")]
    crossed = dataclasses.replace(hand, q_rest=q)
    if not check_hand(crossed):
        q[:8] = np.concatenate([[-0.47, 1.0, 0.5, 0.5], [0.47, 1.0, 0.5, 0.5]])
        crossed = dataclasses.replace(hand, q_rest=np.clip(q, *hand.limits))
    assert check_hand(crossed)[0].startswith("overlap:")
    mended = repaired_rest(crossed)
    assert mended is not None
    assert check_hand(mended) == ()


def test_size_is_to_the_farthest_tip(hand) -> None:
    assert hand_size(hand) == pytest.approx(0.177, abs=1e-3)
    assert hand_size(scale_hand(hand, 1.3)) == pytest.approx(1.3 * hand_size(hand))
