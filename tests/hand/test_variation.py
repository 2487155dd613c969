"""Operations on hands: what each changes, and what none may break."""

import dataclasses

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Coupling, Hand
from xdex_drake.hand.human import human_hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.spheres import fit_spheres
from xdex_drake.hand.variation import (
    Operation,
    apply_operation,
    apply_operations,
    duplicate_link,
    merge_links,
    read_operations,
    remove_finger,
    remove_link,
    scale_hand,
    scale_links,
)
from xdex_drake.hand.yaml_file import hand_digest, read_hand, write_hand

BASES = ("ability", "allegro", "human", "inspire", "schunk_svh", "shadow")


@pytest.fixture(scope="module", params=BASES)
def hand(request: pytest.FixtureRequest) -> Hand:
    return human_hand() if request.param == "human" else load_hand(request.param)


def every_operation(hand: Hand) -> list[Operation]:
    """Each operation at each place of a hand."""
    operations = [Operation("scale_hand", (), (1.2,))]
    operations += [Operation("remove_finger", (finger.name,)) for finger in hand.fingers]
    for link in hand.links:
        operations += [
            Operation("scale_links", (link.name,), (0.85,)),
            Operation("duplicate_link", (link.name,)),
            Operation("duplicate_link", (link.name,), (), True),
            Operation("remove_link", (link.name,)),
            Operation("merge_links", (link.name,)),
        ]
    return operations


def varied(hand: Hand) -> list[tuple[Operation, Hand]]:
    """What comes of the operations that fit."""
    out = []
    for operation in every_operation(hand):
        try:
            out.append((operation, apply_operation(hand, operation)))
        except ConfigError as error:
            assert hand.name in str(error)
    return out


@pytest.fixture(scope="module")
def variations(hand) -> list[tuple[Operation, Hand]]:
    return varied(hand)


def poses(hand: Hand, rest: dict[str, float]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    q = np.array([rest[name] for name in hand.joint_names])
    R, p = forward_kinematics(hand, RigidTransform(), q)
    return {link.name: (R[k], p[k]) for k, link in enumerate(hand.links)}


def rest_of(hand: Hand) -> dict[str, float]:
    return dict(zip((joint.name for joint in hand.joints), hand.q_full(hand.q_rest), strict=True))


def test_most_places_fit(hand, variations) -> None:
    kinds = {operation.kind for operation, _ in variations}
    assert kinds == {"scale_hand", "scale_links", "duplicate_link", "remove_link", "remove_finger", "merge_links"}
    assert len(variations) > 0.6 * len(every_operation(hand))


def test_results_are_whole_descriptions(variations, tmp_path) -> None:
    for k, (operation, result) in enumerate(variations):
        names = [link.name for link in result.links]
        assert len(set(names)) == len(names), operation
        assert [joint.child for joint in result.joints] == names[1:], operation
        masters = set(result.joint_names)
        assert all(j.coupling is None or j.coupling.master in masters for j in result.joints), operation
        assert (result.limits[0] < result.limits[1]).all(), operation
        assert (result.q_rest >= result.limits[0] - 1e-12).all(), operation
        assert (result.q_rest <= result.limits[1] + 1e-12).all(), operation
        for finger in result.fingers:
            assert finger.links[-1] == finger.tip_link, operation
            assert np.linalg.norm(finger.n_LPad) == pytest.approx(1.0)
            assert result.links[result.link_index[finger.tip_link]].geometry, operation
        for link in result.links:
            moments = np.linalg.eigvalsh(link.I_LLcm)
            assert moments[0] > 0.0 and moments[0] + moments[1] >= moments[2] * (1.0 - 1e-9), operation
            assert np.array_equal(link.spheres, fit_spheres(link.geometry)), operation
        for joint in result.joints:
            assert np.abs(joint.R_PJ @ joint.R_PJ.T - np.eye(3)).max() < 1e-12, operation
        if k % 7 == 0:
            write_hand(result, tmp_path / "varied.yaml")
            assert hand_digest(read_hand(tmp_path / "varied.yaml")) == hand_digest(result), operation


def test_provenance_reproduces_the_hand(hand, variations) -> None:
    for operation, result in variations:
        assert read_operations(result.sources["variation"]) == (operation,)
        assert hand_digest(apply_operations(hand, read_operations(result.sources["variation"]))) == hand_digest(result)
        assert hand_digest(result) != hand_digest(hand)


def test_inputs_are_left_alone(hand) -> None:
    digest = hand_digest(hand)
    varied(hand)
    assert hand_digest(hand) == digest
    assert "variation" not in hand.sources


def test_scaling_the_hand_scales_kinematics_exactly(hand) -> None:
    for factor in (0.8, 1.25):
        scaled = scale_hand(hand, factor)
        rng = np.random.default_rng(5)
        q = rng.uniform(*hand.limits)
        R, p = forward_kinematics(hand, RigidTransform(), q)
        R_scaled, p_scaled = forward_kinematics(scaled, RigidTransform(), q)
        assert np.array_equal(R, R_scaled)
        assert np.abs(factor * p - p_scaled).max() < 1e-15
        assert sum(k.mass for k in scaled.links) == pytest.approx(factor**3 * sum(k.mass for k in hand.links))
        assert scaled.effort == pytest.approx(factor**3 * hand.effort)
        for a, b in zip(hand.fingers, scaled.fingers, strict=True):
            assert np.array_equal(factor * a.p_LTip, b.p_LTip)


def test_links_that_are_not_touched_stay_where_they_are(hand, variations) -> None:
    rest = rest_of(hand)
    before = poses(hand, rest)
    parents = {joint.child: joint.parent for joint in hand.joints}

    def above(link: str) -> set[str]:
        chain = {link}
        while link in parents:
            link = parents[link]
            chain.add(link)
        return chain

    for operation, result in variations:
        if operation.kind in ("scale_hand", "remove_finger"):
            continue
        after = poses(result, rest | rest_of(result))
        (touched,) = operation.names
        for name in set(before) & set(after):
            if touched in above(name) and operation.kind != "merge_links":
                continue
            R, p = before[name]
            assert np.abs(after[name][0] - R).max() < 1e-9, (operation, name)
            assert np.abs(after[name][1] - p).max() < 1e-9, (operation, name)


def test_removing_a_finger_leaves_the_others(hand) -> None:
    rng = np.random.default_rng(2)
    before = {}
    for finger in hand.fingers[1:]:
        result = remove_finger(hand, finger.name)
        assert [f.name for f in result.fingers] == [f.name for f in hand.fingers if f is not finger]
        # Coupled joints may be driven by a new master: any posture of the new hand must be one of the old.
        q = rng.uniform(*result.limits)
        values = dict(zip((j.name for j in result.joints), result.q_full(q), strict=True))
        _, p = forward_kinematics(result, RigidTransform(), q)
        joints = {joint.child: joint for joint in hand.joints}
        full = dataclasses.replace(hand, joints=tuple(dataclasses.replace(j, coupling=None) for j in hand.joints))
        q_old = np.array([values.get(j.name, 0.0) for j in full.joints])
        _, p_old = forward_kinematics(full, RigidTransform(), q_old)
        for k, link in enumerate(result.links):
            old = hand.link_index[link.name]
            assert np.abs(p[k] - p_old[old]).max() < 1e-12, (finger.name, link.name)
        before[finger.name] = len(joints) - len(result.joints)
    assert all(count > 0 for count in before.values())


def test_merging_keeps_mass_and_geometry(hand) -> None:
    rest = rest_of(hand)
    for joint in hand.joints:
        child = hand.links[hand.link_index[joint.child]]
        if not child.geometry or any(f.links == (joint.child,) for f in hand.fingers):
            continue
        merged = merge_links(hand, joint.child)
        total = sum(link.mass for link in hand.links)
        assert sum(link.mass for link in merged.links) == pytest.approx(total, abs=0.011)  # a hub's mass may go
        R, p = forward_kinematics(hand, RigidTransform(), hand.q_rest)
        tips = {
            f.name: p[hand.link_index[f.tip_link]] + R[hand.link_index[f.tip_link]] @ f.p_LTip for f in hand.fingers
        }
        q = np.array([rest[name] for name in merged.joint_names])
        R, p = forward_kinematics(merged, RigidTransform(), q)
        for finger in merged.fingers:
            k = merged.link_index[finger.tip_link]
            assert np.abs(p[k] + R[k] @ finger.p_LTip - tips[finger.name]).max() < 1e-12


def test_ignored_contacts_follow_their_links() -> None:
    allegro = load_hand("allegro")
    finger, last = allegro.fingers[1], allegro.fingers[-1]
    base, first, second = allegro.links[0].name, finger.links[0], finger.links[1]
    pairs = ((base, second), (first, last.links[1]), (second, last.links[1]))
    told = dataclasses.replace(allegro, ignored_contacts=pairs)
    assert scale_hand(told, 1.1).ignored_contacts == pairs
    assert remove_finger(told, last.name).ignored_contacts == pairs[:1]
    assert remove_link(told, second).ignored_contacts == pairs[1:2]
    # The parent takes the child's part, once for each pair.
    assert merge_links(told, second).ignored_contacts == ((base, first), (first, last.links[1]))


def test_a_duplicate_continues_its_link(hand) -> None:
    for finger in hand.fingers:
        name = finger.tip_link
        for coupled in (False, True):
            result = duplicate_link(hand, name, coupled=coupled)
            changed = next(f for f in result.fingers if f.name == finger.name)
            assert changed.links == (*finger.links, f"{name}_copy1")
            assert len(result.joints) == len(hand.joints) + 1
            original = next(j for j in hand.joints if j.child == name)
            copy = next(j for j in result.joints if j.child == changed.tip_link)
            if original.coupling is not None:
                assert copy.coupling == original.coupling
            else:
                assert copy.coupling == (Coupling(original.name, 1.0, 0.0) if coupled else None)


def test_a_coupled_joint_finds_a_new_master() -> None:
    hand = load_hand("inspire")
    # The thumb's pitch drives two joints: without its link the first of them is driven, and drives the other.
    result = remove_link(hand, "thumb_proximal")
    laws = {joint.name: joint.coupling for joint in result.joints}
    assert laws["thumb_intermediate_joint"] is None
    assert laws["thumb_distal_joint"] == Coupling("thumb_intermediate_joint", 0.667 / 1.334, 0.0)
    rest = rest_of(hand)
    assert rest_of(result)["thumb_distal_joint"] == pytest.approx(rest["thumb_distal_joint"])


def test_scaling_a_slide() -> None:
    hand = load_hand("ability")
    slide = dataclasses.replace(hand.joints[0], kind="prismatic", lower=0.0, upper=0.02)
    hand = dataclasses.replace(hand, joints=(slide, *hand.joints[1:]), q_rest=np.array([0.01, *hand.q_rest[1:]]))
    scaled = scale_hand(hand, 1.1)
    assert scaled.limits[1, 0] == pytest.approx(0.022)
    _, p = forward_kinematics(hand, RigidTransform(), hand.q_rest)
    _, p_scaled = forward_kinematics(scaled, RigidTransform(), scaled.q_rest)
    assert np.abs(1.1 * p - p_scaled).max() < 1e-15


def test_what_does_not_fit_is_refused() -> None:
    hand = load_hand("ability")
    with pytest.raises(ConfigError, match="no link 'nose'"):
        remove_link(hand, "nose")
    with pytest.raises(ConfigError, match="not part of a finger"):
        duplicate_link(hand, hand.links[0].name)
    with pytest.raises(ConfigError, match="not positive"):
        scale_links(hand, {"index_L1": -1.0})
    with pytest.raises(ConfigError, match="no operation"):
        read_operations("explode(index_L1)")
    with pytest.raises(ConfigError, match="factor"):
        read_operations("scale_hand()")
    one = remove_link(hand, "index_L2")
    with pytest.raises(ConfigError, match="all that"):
        remove_link(one, "index_L1")
    with pytest.raises(ConfigError, match="all that moves"):
        merge_links(one, "index_L1")
