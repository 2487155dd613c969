import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.evaluation.metrics import (
    joint_entropy,
    normalised_entropy,
    position_difference,
    success_rate,
    vector_difference,
    wilson_interval,
)
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.library import load_hand


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro")


def grasp_of(hand, X_WH=None, q=None, lift=None):
    X_WH = RigidTransform() if X_WH is None else X_WH
    return Grasp(hand.name, "can", RigidTransform(), X_WH, hand.q_rest if q is None else q, lift=lift)


def test_a_grasp_differs_from_itself_by_nothing(allegro):
    g = grasp_of(allegro)
    assert position_difference(allegro, g, allegro, g) == 0.0
    assert vector_difference(allegro, g, allegro, g) == 0.0


def test_a_moved_hand_differs_in_position_only(allegro):
    shift = RigidTransform(RollPitchYaw(0.0, 0.0, 0.0), [0.03, 0.04, 0.0])
    a, b = grasp_of(allegro), grasp_of(allegro, shift)
    assert position_difference(allegro, a, allegro, b) == pytest.approx(5.0)
    assert vector_difference(allegro, a, allegro, b) == pytest.approx(0.0, abs=1e-9)
    # The vector difference does not see where the pair stands.
    c = grasp_of(allegro, RigidTransform(RollPitchYaw(0.4, 1.0, -2.0), [1.0, 2.0, 3.0]))
    assert vector_difference(allegro, a, allegro, c) == pytest.approx(0.0, abs=1e-9)


def test_different_hands_compare_by_the_names_of_their_fingers(allegro):
    shadow = load_hand("shadow")
    d = vector_difference(allegro, grasp_of(allegro), shadow, grasp_of(shadow))
    assert 1.0 < d < 15.0
    assert d == pytest.approx(vector_difference(shadow, grasp_of(shadow), allegro, grasp_of(allegro)))


def test_entropy_is_zero_for_one_value_and_ln_n_for_n(allegro):
    same = np.tile(allegro.q_rest, (50, 1))
    assert joint_entropy(allegro, same) == (0.0, 0.0)
    low, high = allegro.limits
    spread = low + (high - low) * np.linspace(0.005, 0.995, 50)[:, None]
    mean, deviation = joint_entropy(allegro, spread)
    assert mean == pytest.approx(np.log(50)) and deviation == pytest.approx(0.0, abs=1e-12)


def test_normalised_entropy_is_a_share_of_the_greatest(allegro):
    low, high = allegro.limits
    even = low + (high - low) * (np.arange(64)[:, None] + 0.5) / 64
    assert normalised_entropy(allegro, even) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-12))
    half = low + 0.5 * (high - low) * (np.arange(64)[:, None] + 0.5) / 64
    assert normalised_entropy(allegro, half)[0] == pytest.approx(np.log(16) / np.log(32))
    assert normalised_entropy(allegro, even[:1]) == (0.0, 0.0)


def test_wilson_and_success_rate(allegro):
    low, high = wilson_interval(8, 10)
    assert low == pytest.approx(0.490, abs=1e-3) and high == pytest.approx(0.943, abs=1e-3)
    assert wilson_interval(0, 0) == (0.0, 1.0)
    done = Lift("lift-0.2/2tips", True, "", 0.25, ("thumb", "index"), 0.1)
    assert success_rate([grasp_of(allegro, lift=done), grasp_of(allegro)]) == 0.5
