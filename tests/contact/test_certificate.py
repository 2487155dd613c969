"""Certificates: made, checked again, and refused when they are altered."""

from dataclasses import replace

import numpy as np
import pytest

from tests.contact.references import MU, RADIUS, ball_grasp, ring_grasp
from xdex_drake.contact import Effort, HeldObject, certified_map, certify, check_certificate, contact_frames
from xdex_drake.errors import ConfigError

P_OOCM = np.array([0.002, 0.0, 0.001])


def make(p, normals, R_WO=np.eye(3), p_OOcm=P_OOCM, **options):  # noqa: B008
    links = [f"link_{i}" for i in range(len(p))]
    return certify(p, normals, links, HeldObject(0.1, RADIUS, p_OOcm, MU, R_WO), **options)


def certified(seed=0, n=4):
    rng = np.random.default_rng(seed)
    while True:
        result = make(*ball_grasp(rng, n), R_WO=contact_frames(rng.normal(size=3)))
        if result.certificate is not None and result.certificate.margin_lower > 0.02:
            return result.certificate


@pytest.mark.parametrize("n", [3, 4, 6])
def test_certificates_pass_their_check(n):
    certificate = certified(n, n)
    residuals = check_certificate(certificate)
    assert residuals.passes(), residuals
    assert residuals.wrench <= 1e-9 and residuals.cone == 0.0
    assert certificate.witness_forces.shape == (12, 3 * n)
    assert certificate.margin_upper - certificate.margin_lower <= 1e-3 + 1e-12
    assert certificate.task_margin >= 0.0


def test_check_uses_no_solver(monkeypatch):
    import clarabel

    certificate = certified()
    monkeypatch.delattr(clarabel, "DefaultSolver")
    assert check_certificate(certificate).passes()


def test_alterations_are_found():
    certificate = certified()
    first, *others = certificate.contacts
    altered = {
        "force": replace(certificate, contacts=(replace(first, f_C=1.01 * first.f_C), *others)),
        "friction": replace(certificate, contacts=tuple(replace(c, mu=0.01) for c in certificate.contacts)),
        "point": replace(certificate, contacts=(replace(first, p_OC=first.p_OC + 1e-3), *others)),
        "mass": replace(certificate, mass=1.01 * certificate.mass),
        "rotation": replace(certificate, R_WO=contact_frames([1.0, 2.0, 0.5])),
        "lower": replace(certificate, margin_lower=1.01 * certificate.margin_lower),
        "upper": replace(certificate, margin_upper=0.5 * certificate.margin_upper),
        "witness": replace(certificate, witness_forces=1.01 * certificate.witness_forces),
        "length": replace(certificate, length=0.0),
        "no mass": replace(certificate, mass=0.0),
        "negative friction": replace(certificate, contacts=(replace(first, mu=-0.1), *others)),
        "no normal": replace(certificate, contacts=(replace(first, n_OC=np.zeros(3)), *others)),
        "nan": replace(certificate, contacts=(replace(first, f_C=np.full(3, np.nan)), *others)),
        "empty": replace(certificate, contacts=()),
    }
    for name, value in altered.items():
        assert not check_certificate(value).passes(), name


def test_a_pinch_through_the_center_of_mass_is_certified_without_a_ball():
    p, normals = ring_grasp(2)
    certificate = make(p, normals, p_OOcm=np.zeros(3)).certificate
    assert certificate is not None and certificate.margin_lower == 0.0 and certificate.margin_upper == 0.0
    assert check_certificate(certificate).passes()


def test_refusals_say_why():
    p, normals = ring_grasp(3)
    assert "friction" in make(p[:1], normals[:1]).reason
    assert "no contact" in make(np.zeros((0, 3)), np.zeros((0, 3))).reason
    weak = make(p, normals, effort=Effort(np.eye(9), np.full(9, 0.01)))
    assert weak.certificate is None and "effort" in weak.reason


def test_turning_grasp_and_gravity_together_changes_nothing():
    rng = np.random.default_rng(3)
    p, normals = ring_grasp(4)
    p = p + 0.002 * rng.normal(size=p.shape)
    Q, t = contact_frames(rng.normal(size=3)), rng.normal(size=3)
    base = make(p, normals).certificate
    # The same grasp in another object frame: p_O' = Q p_O + t, hence R_WO' = Q^T.
    other = make(p @ Q.T + t, normals @ Q.T, R_WO=Q.T, p_OOcm=Q @ P_OOCM + t).certificate
    assert base is not None and other is not None and check_certificate(other).passes()
    assert other.task_margin == pytest.approx(base.task_margin, abs=1e-4)
    assert other.margin_lower == pytest.approx(base.margin_lower, abs=1.1e-3)


def test_contact_frames_are_fixed_to_the_object():
    p, normals = ring_grasp(3)
    R_WO = contact_frames([0.3, -0.2, 0.9])
    G = HeldObject(0.1, RADIUS, np.zeros(3), MU, R_WO).grasp_map(p, normals).G
    R_WCs = np.moveaxis(G[3:].reshape(3, 3, 3), 0, 1)
    assert pytest.approx(R_WO @ contact_frames(normals)) == R_WCs
    assert pytest.approx(normals @ R_WO.T) == R_WCs[..., 2]
    assert certified_map(certificate := make(p, normals, R_WO).certificate).mu == pytest.approx(MU)
    assert certificate.contacts[1].mu == MU


def test_friction_may_differ_between_contacts():
    mu = np.array([0.4, 0.6, 0.8])
    held = HeldObject(0.1, RADIUS, np.zeros(3), mu, np.eye(3))
    certificate = certify(*ring_grasp(3), ["a", "b", "c"], held).certificate
    assert certificate is not None and [c.mu for c in certificate.contacts] == list(mu)
    assert check_certificate(certificate).passes()
    with pytest.raises(ConfigError, match="mass"):
        HeldObject(0.0, RADIUS, np.zeros(3), MU, np.eye(3))


def test_friction_left_is_what_the_forces_were_told_to_spare():
    certificate = certified()
    for safety in (0.9, 0.7):
        result = make(
            [c.p_OC for c in certificate.contacts],
            [c.n_OC for c in certificate.contacts],
            R_WO=certificate.R_WO,
            safety=safety,
            min_normal=0.3,
        )
        if result.certificate is not None:
            assert result.certificate.friction_left >= 1.0 - safety - 1e-9
    pushed = replace(
        certificate, contacts=tuple(replace(c, f_C=np.array([0.0, 0.0, 1.0])) for c in certificate.contacts)
    )
    assert pushed.friction_left == 1.0
    first, *others = pushed.contacts
    at_the_edge = replace(first, f_C=np.array([0.0, 2.0 * first.mu, 2.0]))
    assert replace(pushed, contacts=(at_the_edge, *others)).friction_left == pytest.approx(0.0)
