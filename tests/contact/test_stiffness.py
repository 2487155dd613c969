"""Stiffness under load: closed forms, finite differences, symmetry."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from tests.contact.elastic import HANDS, balanced, some_grasp, stiffness_of
from xdex_drake.contact.cones import contact_frames
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.contact.stiffness import FLATTEST, GraspStiffness, grasp_stiffness, response, tip_curvatures
from xdex_drake.hand.kinematics import Configuration, rotation_about
from xdex_drake.hand.library import load_hand


@pytest.mark.parametrize("name", HANDS)
def test_jacobian_slopes_are_derivatives_of_the_jacobian(name):
    k, links, p_WCs, _ = some_grasp(name)
    p_LCs = np.einsum("mba,mb->ma", k.R_WLs[links], p_WCs - k.p_WLs[links])
    slopes, step = k.jacobian_slopes(links, p_WCs), 1e-6

    def jacobian(q):
        moved = Configuration.at(k.hand, k.X_WH, q)
        return moved.jacobian(links, moved.points(links, p_LCs))[:, :, 6:]

    for j, e in enumerate(np.eye(len(k.q))):
        difference = (jacobian(k.q + step * e) - jacobian(k.q - step * e)) / (2.0 * step)
        assert np.allclose(slopes[:, :, :, j], difference, atol=1e-8)
    assert np.allclose(slopes, np.swapaxes(slopes, -1, -2), atol=1e-15)


@pytest.mark.parametrize("name", HANDS)
def test_object_stiffness_is_symmetric_where_forces_balance_and_only_there(name):
    k, links, p_WCs, n_WCs = some_grasp(name)
    stiffness = stiffness_of(k, links, p_WCs, n_WCs, p_WCs.mean(axis=0))
    f = balanced(stiffness)
    K_x = stiffness.object_stiffness(f)
    assert np.abs(K_x - K_x.T).max() < 1e-6
    H = stiffness.hessian(f)
    assert np.abs(H - H.T).max() < 1e-6
    twisted = f + np.array([0.5, 0.0, 0.0] + [0.0] * (len(f) - 3))
    K_x = stiffness.object_stiffness(twisted)
    assert np.abs(K_x - K_x.T).max() > 1e-3


@pytest.mark.parametrize("name", HANDS)
def test_the_hessian_is_that_of_the_energy(name):
    """Points that do not roll: gradient of 1/2 Kp dq^2 + sum f . (p_h - p_o) + contact springs, by differences."""
    k, links, p_WCs, n_WCs = some_grasp(name)
    p_WOcm = p_WCs.mean(axis=0)
    stiffness = stiffness_of(k, links, p_WCs, n_WCs, p_WOcm, radius=1e-9)
    f, m = balanced(stiffness), len(stiffness.kp)
    R_WCs = contact_frames(n_WCs)
    p_LCs = np.einsum("mba,mb->ma", k.R_WLs[links], p_WCs - k.p_WLs[links])
    f_Ws = np.einsum("cab,cb->ca", R_WCs, f.reshape(-1, 3))

    def energy(z):
        q = k.q.copy()
        q[stiffness.joints] += z[:m]
        p_h = Configuration.at(k.hand, k.X_WH, q).points(links, p_LCs)
        angle = float(np.linalg.norm(z[m : m + 3]))
        R = rotation_about(z[m : m + 3] / angle, angle) if angle > 0.0 else np.eye(3)
        p_o = p_WOcm + z[m + 3 :] + (p_WCs - p_WOcm) @ R.T
        gap = np.einsum("cba,cb->ca", R_WCs, p_h - p_o).ravel()
        return 0.5 * z[:m] @ z[:m] + float((f_Ws * (p_h - p_o)).sum()) + 0.5 * gap @ (gap / stiffness.compliance)

    step, n = 3e-4, m + 6
    H = stiffness.hessian(f)
    for i in range(n):
        for j in (i, (i + 3) % n):
            a, b = step * np.eye(n)[i], step * np.eye(n)[j]
            second = (energy(a + b) - energy(a - b) - energy(b - a) + energy(-a - b)) / (4.0 * step**2)
            assert second == pytest.approx(H[i, j], abs=1e-3 + 2e-3 * abs(H[i, j]))


def fixed_fingers(p_WCs, n_WCs, radius, spring) -> GraspStiffness:
    """Contacts of a hand that does not give way: its contacts' springs alone."""
    hand = load_hand("allegro")
    k = Configuration.at(hand, RigidTransform(), hand.q_rest)
    links = np.zeros(len(p_WCs), dtype=np.int64)  # the base: no joint moves it
    tips = (np.eye(3) - n_WCs[:, :, None] * n_WCs[:, None, :]) / radius
    return grasp_stiffness(
        k,
        links,
        p_WCs,
        contact_frames(n_WCs),
        np.zeros(3),
        kp=1.0,
        tip_curvatures=tips,
        compliance=(1.0 / spring, 1.0 / spring),
    )


@pytest.mark.parametrize("radius", [1e-3, 8e-3])
def test_a_pinch(radius):
    """Two balls that press a plate of width 2 a with F: rotations about the tangents have 2 (k a^2 - F (a - rho))."""
    a, F, spring = 0.03, 4.0, 500.0
    p_WCs = np.array([[a, 0.0, 0.0], [-a, 0.0, 0.0]])
    stiffness = fixed_fingers(p_WCs, -p_WCs / a, radius, spring)
    K = stiffness.object_stiffness(np.array([0.0, 0.0, F] * 2))
    tangent = 2.0 * (spring * a * a - F * (a - radius))
    assert np.allclose(np.diag(K), [0.0, tangent, tangent, *[2.0 * spring] * 3], atol=1e-9)
    assert np.allclose(K, np.diag(np.diag(K)), atol=1e-9)


def test_three_on_a_ball():
    """Three contacts on a great circle: translations 3 k, rotations about the plane's axes and its normal."""
    a, F, spring, radius = 0.04, 2.0, 800.0, 6e-3
    angle = 2.0 * np.pi * np.arange(3) / 3
    p_WCs = a * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    stiffness = fixed_fingers(p_WCs, -p_WCs / a, radius, spring)
    K = stiffness.object_stiffness(np.tile([0.0, 0.0, F], 3))
    # Each contact resists rotations across its arm by k a^2 - F (a - rho), those along it not at all.
    across = spring * a * a - F * (a - radius)
    assert np.allclose(np.diag(K), [1.5 * across, 1.5 * across, 3.0 * across, *[3.0 * spring] * 3])
    assert np.allclose(K, np.diag(np.diag(K)), atol=1e-9)


def test_faces_count_as_round():
    p_WCs = np.array([[0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]])
    flat = fixed_fingers(p_WCs, -p_WCs / 0.03, 1e6, 500.0)
    same = fixed_fingers(p_WCs, -p_WCs / 0.03, FLATTEST, 500.0)
    assert np.allclose(flat.geometric, same.geometric)


@pytest.mark.parametrize("name", HANDS)
def test_the_response_balances_the_push(name):
    k, links, p_WCs, n_WCs = some_grasp(name)
    stiffness = stiffness_of(k, links, p_WCs, n_WCs, p_WCs.mean(axis=0))
    f, w = balanced(stiffness), np.array([[0.01, 0.0, 0.02, 0.3, -0.2, 0.5]])
    changes = response(stiffness, f, w)
    K_x = stiffness.object_stiffness(f)
    assert np.allclose(K_x @ changes.x[:, 0], w[0], atol=1e-9)
    # Without load nothing is geometric, and the contacts alone carry the push by K_c G' K_x^-1 w.
    unloaded = response(stiffness, 0.0 * f, w)
    assert np.allclose(stiffness.G @ unloaded.df[:, 0], -w[0], atol=1e-8)
    K_c = np.linalg.inv(stiffness.contact_compliance(0.0 * f))
    K_x = stiffness.G @ K_c @ stiffness.G.T
    assert np.allclose(unloaded.df[:, 0], -K_c @ stiffness.G.T @ np.linalg.solve(K_x, w[0]), rtol=1e-5, atol=1e-7)


def test_a_finger_that_pushes_along_itself_buckles():
    """A force F away from a joint at distance l takes F l from that joint's own stiffness."""
    k, links, p_WCs, _ = some_grasp("allegro", nc=2)
    root = k.hand.link_index[k.hand.fingers[0].links[0]]
    arm = p_WCs[:1] - k.p_WLs[root]
    n_WCs = arm / np.linalg.norm(arm)
    stiffness = stiffness_of(k, links[:1], p_WCs[:1], n_WCs, p_WCs[0] + 0.05 * n_WCs[0])
    f, axis = np.array([0.0, 0.0, 1.0]), k.vectors(np.array([root]), k.hand.joints[root - 1].axis[None])[0]
    K_q = stiffness.joint_stiffness(f)
    first = list(stiffness.joints).index(k.hand.joint_names.index(k.hand.joints[root - 1].name))
    across = arm[0] - axis * (axis @ arm[0])
    assert K_q[first, first] == pytest.approx(1.0 - float(across @ n_WCs[0]))
    least = [float(np.linalg.eigvalsh(stiffness.joint_stiffness(s * f))[0]) for s in (0.0, 5.0, 50.0)]
    assert least[0] == pytest.approx(1.0)
    assert least[0] > least[1] > least[2] and least[2] < 0.0


def test_tips_are_as_round_as_their_shapes():
    hand = load_hand("allegro")
    k = Configuration.at(hand, RigidTransform(), hand.q_rest)
    for finger in hand.fingers:
        link = hand.link_index[finger.tip_link]
        p_WC = k.points(np.array([link]), finger.p_LTip[None])
        n_WC = k.vectors(np.array([link]), finger.n_LPad[None])
        curvature = tip_curvatures(hand, k, np.array([link]), p_WC, n_WC)[0]
        assert np.allclose(curvature @ n_WC[0], 0.0, atol=1e-9)
        assert np.allclose(curvature, curvature.T)
        assert np.linalg.eigvalsh(curvature)[0] > -1e-9


def test_frames_are_those_of_certificates():
    k, links, p_WCs, n_WCs = some_grasp("allegro")
    held = HeldObject(0.1, 0.05, p_WCs.mean(axis=0), 0.6, np.eye(3))
    stiffness = stiffness_of(k, links, p_WCs, n_WCs, p_WCs.mean(axis=0))
    assert np.allclose(held.grasp_map(p_WCs, n_WCs).G, stiffness.G)
