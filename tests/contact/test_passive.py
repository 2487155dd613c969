"""The passive squeeze and the motion under pushes: what they promise, closed forms, faults."""

from dataclasses import replace

import numpy as np
import pytest

from tests.contact.elastic import some_grasp, stiffness_of
from xdex_drake.contact.cones import contact_frames, effort_map
from xdex_drake.contact.grasp_map import Effort, GraspMap
from xdex_drake.contact.passive import (
    Loads,
    SqueezeSettings,
    check_squeeze,
    elastic_margin,
    linear_law,
    passive_squeeze,
    reachable_forces,
)
from xdex_drake.contact.sliding import LOST, pushed_motion
from xdex_drake.contact.stiffness import response
from xdex_drake.contact.wrench import gravity_wrench, push_wrenches

MASS, MU, LENGTH = 0.1, 0.8, 0.05
INERTIA = 5e-5 * np.eye(3)


def system(name, nc=4, efforts=np.inf, at_stop=None):
    """An elastic grasp of fingertips and its loads."""
    k, links, p_WCs, n_WCs = some_grasp(name, nc)
    stiffness = stiffness_of(k, links, p_WCs, n_WCs, p_WCs.mean(axis=0))
    A = effort_map(k.jacobian(links, p_WCs)[:, :, 6:], contact_frames(n_WCs))
    stops = np.zeros(len(A), dtype=int) if at_stop is None else at_stop
    loads = Loads(
        GraspMap(stiffness.G, MU, LENGTH),
        Effort(A, np.full(len(A), efforts)),
        gravity_wrench(MASS),
        push_wrenches(MASS),
        stops,
    )
    return stiffness, loads, np.tile([0.0, 0.0, 1.0], len(links))


EASY = SqueezeSettings(object_stiffness=1.0, joint_stiffness=0.01, rounds=3)


@pytest.fixture(scope="module", params=["allegro", "inspire", "schunk_svh"])
def solved(request):
    stiffness, loads, start = system(request.param)
    return stiffness, loads, passive_squeeze(stiffness, loads, start, EASY)


def test_a_squeeze_keeps_its_promises(solved):
    stiffness, loads, squeeze = solved
    assert squeeze.status == "solved", squeeze.reason
    residuals = check_squeeze(squeeze, stiffness, loads, EASY)
    assert residuals.passes(1e-5), residuals
    assert residuals.cone < 0.5
    normal = squeeze.f[2::3]
    assert np.all(normal > EASY.least - 1e-5) and np.all(normal < EASY.greatest + 1e-5)
    assert squeeze.margin > 0.0 and squeeze.elastic_margin >= 0.0
    assert squeeze.joint_eigenvalue > EASY.joint_stiffness - 1e-5
    assert squeeze.object_eigenvalue > 0.0
    assert np.allclose(squeeze.torques, loads.effort.A @ squeeze.f)


def test_the_check_sees_what_is_wrong(solved):
    stiffness, loads, squeeze = solved
    f = squeeze.f.copy()
    f[0] += 0.2
    assert not check_squeeze(replace(squeeze, f=f), stiffness, loads, EASY).passes(1e-5)
    more = replace(squeeze, object_eigenvalue=2.0 * squeeze.object_eigenvalue)
    assert check_squeeze(more, stiffness, loads, EASY).stability > 0.4
    far = check_squeeze(replace(squeeze, margin=20.0), stiffness, loads, EASY)
    assert far.cone > 1.0
    assert check_squeeze(replace(squeeze, slips=squeeze.slips + 0.01), stiffness, loads, EASY).slip > 5e-3


def test_without_slips_the_margin_is_the_elastic_one():
    """The program's optimum against the closed form at its forces."""
    stiffness, loads, start = system("allegro")
    settings = replace(EASY, slip=0.0, friction=1.0, enough=50.0, worth=1e4, rounds=8, greatest=2.0)
    squeeze = passive_squeeze(stiffness, loads, start, settings)
    assert squeeze.status == "solved" and not squeeze.slips.any()
    assert squeeze.elastic_margin == pytest.approx(squeeze.margin, rel=1e-3)


def test_slips_only_help():
    stiffness, loads, start = system("inspire")
    margins = [
        passive_squeeze(stiffness, loads, start, replace(EASY, slip=slip, enough=50.0, worth=1e4, rounds=1)).margin
        for slip in (0.0, 1e-4, 1e-3)
    ]
    assert margins[0] < margins[1] < margins[2]


def test_commanded_forces_come_from_joints():
    """Forces of any targets lie in the reach; Inspire's four joints reach fewer than forces that balance have."""
    stiffness, loads, _ = system("inspire")
    reach = reachable_forces(stiffness, loads.gravity, LENGTH)
    assert reach.residual < 1e-9
    assert reach.basis.shape[1] <= len(stiffness.joints)
    m, rng = len(stiffness.kp), np.random.default_rng(0)
    # Elastic solution of targets u under gravity: K z = (Kp u, gravity), f = C_s^-1 E z.
    E = np.concatenate([stiffness.J, -stiffness.G.T], axis=1)
    z = np.linalg.solve(stiffness.elastic, np.concatenate([rng.normal(size=m), loads.gravity]))
    f = E @ z / stiffness.compliance
    assert np.linalg.norm(stiffness.G @ f + loads.gravity) < 1e-6
    off = f - reach.at
    assert np.linalg.norm(off - reach.basis @ (reach.basis.T @ off)) < 1e-4 * np.linalg.norm(f)


def test_efforts_are_respected_at_rest_and_when_pushed():
    stiffness, loads, start = system("allegro")
    free = passive_squeeze(stiffness, loads, start, EASY)
    limit = 0.8 * float(np.abs(free.torques).max())
    tight = replace(loads, effort=Effort(loads.effort.A, np.full(len(loads.effort.A), limit)))
    squeeze = passive_squeeze(stiffness, tight, start, EASY)
    assert squeeze.status == "solved"
    assert np.abs(loads.effort.A @ squeeze.f).max() <= limit * (1.0 + 1e-5)
    assert squeeze.margin <= free.margin + 1e-6


def test_what_cannot_be_held_has_a_reason():
    stiffness, loads, start = system("allegro")
    heavy = replace(loads, gravity=gravity_wrench(20.0))
    squeeze = passive_squeeze(stiffness, heavy, start, EASY)
    assert squeeze.status != "solved" and squeeze.reason and squeeze.margin == 0.0
    stiff = passive_squeeze(stiffness, loads, start, replace(EASY, joint_stiffness=1.5))
    assert stiff.status != "solved"


def test_the_elastic_margin_in_closed_form():
    """A force (0, 0, n) that a push changes by (s a, 0, 0) leaves its cone at s = mu n / a."""
    f = np.array([0.0, 0.0, 2.0])
    assert elastic_margin(f, np.array([[0.5], [0.0], [0.0]]), np.array([0.6])) == pytest.approx(2.4)
    assert elastic_margin(f, np.array([[0.5], [0.0], [1.0]]), np.array([0.6])) == 100.0
    assert elastic_margin(f, np.array([[0.0], [0.0], [-0.5]]), np.array([0.6])) == pytest.approx(4.0)
    assert elastic_margin(np.array([2.0, 0.0, 1.0]), np.zeros((3, 1)), np.array([0.6])) == 0.0


def test_small_pushes_move_as_the_stiffness_says():
    """The stepped motion ends where the linear law does, as long as nothing slides and joints give way everywhere."""
    stiffness, loads, start = system("allegro")
    squeeze = passive_squeeze(stiffness, loads, start, EASY)
    small = 0.5 * min(squeeze.elastic_margin, 1.0) * loads.pushes
    moved = pushed_motion(stiffness, squeeze.f, MU, small, mass=MASS, inertia=INERTIA)
    x = response(stiffness, squeeze.f, small).x
    assert np.allclose(moved.shift, np.linalg.norm(x[3:], axis=0), rtol=0.1)


def test_great_pushes_take_the_object_away(solved):
    stiffness, loads, squeeze = solved
    moved = pushed_motion(stiffness, squeeze.f, 0.1 * MU, 30.0 * loads.pushes, mass=MASS, inertia=INERTIA)
    assert np.all(moved.shift <= LOST) and moved.shift.max() > 0.05
    assert np.all(np.isfinite(moved.f))


def test_slips_change_forces_as_the_law_says():
    """-W g is what remains of a contact's own spring once joints and object have followed."""
    stiffness, loads, start = system("allegro", nc=3)
    law = linear_law(stiffness, start, loads.pushes)
    assert np.allclose(stiffness.G @ law.slips, 0.0, atol=0.05 * np.abs(law.slips).max())
    W = -law.slips[(3 * np.arange(3)[:, None] + np.arange(2)).ravel()]
    assert np.allclose(W, W.T, rtol=1e-6, atol=1e-6 * np.abs(W).max())
