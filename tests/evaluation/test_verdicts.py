"""Tables of verdicts: what is counted, and how sure it is."""

import dataclasses

import numpy as np
import pytest

from xdex_drake.evaluation.verdicts import Verdict, bootstrap, lines, read_verdicts, write_verdicts

ONE = Verdict("unseen", "inspire", "can-0", "raw", 0, True, True, "", 0.02, 0.3, 4.0, 0.1)


def _verdicts(rates, scenes=10, samples=4, seed=0):
    """Verdicts of hands that lift with given rates, independently."""
    rng = np.random.default_rng(seed)
    found = []
    for hand, rate in rates.items():
        for scene in range(scenes):
            for sample in range(samples):
                lifted = bool(rng.random() < rate)
                reason = "" if lifted else "slipped"
                found.append(
                    dataclasses.replace(ONE, hand=hand, scene=f"s{scene}", sample=sample, lifted=lifted, reason=reason)
                )
    return found


def test_files_keep_verdicts(tmp_path):
    lost = dataclasses.replace(ONE, found=False, lifted=False, reason='cone, by "far"', penetration_cm=float("nan"))
    write_verdicts(tmp_path / "v.csv", [ONE, lost])
    found = read_verdicts(tmp_path / "v.csv")
    assert found[0] == ONE
    assert found[1].reason == lost.reason and np.isnan(found[1].penetration_cm) and not found[1].found


def test_a_draw_that_became_no_grasp_is_a_failure_and_has_no_depth():
    lost = dataclasses.replace(ONE, sample=1, found=False, lifted=False, reason="cone", penetration_cm=float("nan"))
    (line,) = lines([ONE, lost])
    assert (line.trials, line.lifted, line.found) == (2, 0.5, 0.5)
    assert line.penetration_cm == pytest.approx(0.02) and line.reasons == {"cone": 1}


def test_hands_stand_by_themselves_and_their_group_after_them():
    found = _verdicts({"a": 0.9, "b": 0.3})
    table = lines(found)
    assert [(line.name, line.stage) for line in table] == [("a", "raw"), ("b", "raw"), ("all unseen", "raw")]
    a, b, both = table
    assert both.lifted == pytest.approx((a.lifted + b.lifted) / 2)
    # Hands that differ leave more doubt than the number of draws alone would say.
    wilson = a.high - a.low
    assert both.high - both.low > 1.3 * wilson
    assert a.low < 0.9 < a.high and both.low < 0.6 < both.high


def test_the_bootstrap_covers_the_truth():
    """Of intervals of 95 % over 24 hands and 12 scenes, nearly all hold the rate that made the verdicts."""
    inside = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        rates = {f"h{k}": float(rng.uniform(0.4, 0.8)) for k in range(24)}
        low, high = bootstrap(_verdicts(rates, scenes=12, samples=1, seed=seed), draws=200, seed=seed)
        inside += low <= 0.6 <= high
    assert inside >= 26
    assert bootstrap([]) == (0.0, 1.0)
