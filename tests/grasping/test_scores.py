"""Scores: their features and their form by hand, what ships, and what is refused."""

import json

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Certificate, Contact, Grasp
from xdex_drake.grasping.scores import (
    FEATURES,
    FILE,
    Curve,
    Score,
    features,
    hold_probability,
    lift_probability,
    probability,
    read_scores,
    shipped_scores,
)

NAMES = list(FEATURES)


def grasp(**facts):
    """Two contacts 3 cm and 5 cm high, of 2 N and 4 N, on a ball of 100 g whose center is 4 cm high."""
    proof = Certificate(
        contacts=(
            Contact("a", np.array([0.03, 0.0, -0.01]), np.array([-1.0, 0.0, 0.0]), 0.5, np.array([0.3, 0.4, 2.0])),
            Contact("b", np.array([0.01, 0.0, 0.01]), np.array([1.0, 0.0, 0.0]), 0.5, np.array([0.0, 0.4, 4.0])),
        ),
        R_WO=np.eye(3),
        p_OOcm=np.zeros(3),
        mass=0.1,
        length=0.04,
        wrench_residual=0.0,
        task_margin=1.5,
        margin_lower=0.07,
        margin_upper=0.08,
    )
    facts = {"penetration_parts_m": 1e-4, "penetration_mesh_m": 2e-4, "foretold_motion": -0.5} | facts
    return Grasp("h", "o", RigidTransform([0.1, 0.2, 0.04]), RigidTransform(), np.zeros(2), proof, **facts)


def test_features_are_what_their_names_say():
    row = dict(zip(NAMES, features([grasp(stiffness_least=np.e)])[0], strict=True))
    expected = {
        "task_margin": 1.5,
        "ball_margin": 0.07,
        "friction_left": 0.5,
        "foretold_motion": -0.5,
        "log_stiffness": 1.0,
        "contacts": 2.0,
        "log_squeeze": np.log(6.0 / 0.981),
        "log_weakest": np.log(2.0 / 0.981),
        "lowest_contact_mm": 30.0,
        "center_height_mm": 40.0,
        "offset": 0.5,
        "length_mm": 40.0,
        "penetration_mm": 0.2,
    }
    assert {name: row[name] for name in expected} == pytest.approx(expected)
    assert np.isnan(row["squeeze_margin"]) and row.keys() == {*expected, "squeeze_margin"}


def test_log_odds_add_up():
    curves = (
        Curve("task_margin", (1.0, 2.0), (-1.0, 3.0), 9.0),
        Curve("squeeze_margin", (0.0,), (5.0,), -0.25),
        Curve("foretold_motion", (0.0, 1.0), (0.125, -4.0), 9.0),
    )
    x = features([grasp(), Grasp("h", "o", RigidTransform(), RigidTransform(), np.zeros(2))])
    found = probability(Score(0.5, curves), x)
    assert found[0] == pytest.approx(1.0 / (1.0 + np.exp(-(0.5 + 1.0 - 0.25 + 0.125))))
    assert np.isnan(found[1]) and probability(Score(0.0, ()), x[:1]) == 0.5


def test_what_ships_is_sane():
    scores = shipped_scores()
    assert scores.version and {c.feature for c in scores.lift.curves} <= FEATURES.keys()
    for score in (scores.lift, scores.hold):
        (motion,) = (curve for curve in score.curves if curve.feature == "foretold_motion")
        assert motion.values[0] > motion.values[-1]  # what is foretold to move more holds less
    some = [grasp(foretold_motion=value) for value in (-1.5, 1.5)]
    lift, hold = lift_probability(some), hold_probability(some)
    assert ((lift > 0.0) & (lift < 1.0)).all() and hold[0] > hold[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"feature": "colour"}, "no feature 'colour'"),
        ({"knots": [1.0, 0.0]}, "ascending knots"),
        ({"values": [0.0]}, "a value for each"),
        ({"weight": 1}, "unknown key"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path, change, message):
    curve = {"feature": "offset", "knots": [0.0, 1.0], "values": [0.0, 1.0], "missing": 0.0} | change
    values = json.loads(FILE.read_text()) | {"lift": {"constant": 0.0, "curves": [curve]}}
    (tmp_path / "s.json").write_text(json.dumps(values))
    with pytest.raises(ConfigError, match=message):
        read_scores(tmp_path / "s.json")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_scores(tmp_path / "none.json")
