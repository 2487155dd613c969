"""When a batch of candidates is left for the next one."""

import pytest

from xdex_drake.grasping.synthesis import WINDOW, worth_going_on


def polished(hits: str, batch: int = 80) -> int:
    """How many of a batch are polished where `x` would be certified and `.` would not."""
    seen: list[bool] = []
    for hit in hits:
        if not worth_going_on(seen, batch):
            break
        seen.append(hit == "x")
    return len(seen)


@pytest.mark.parametrize(
    ("hits", "least", "most"),
    [
        ("x" * 80, 80, 80),  # all are good: none is left
        ("." * 80, WINDOW, WINDOW),  # none is: a new batch
        ("x" * 20 + "." * 60, 24, 27),  # the good ones come first, and a few misses show that they are over
        ("." * 4 + "x" * 20, 24, 24),  # a bad beginning alone is no reason
        ("x..." * 20, 60, 80),  # a steady rate pays as well as a new batch's would, which costs a search besides
    ],
)
def test_a_batch_is_left_where_its_rate_falls_below_the_average(hits, least, most):
    assert least <= polished(hits) <= most


def test_a_dear_search_makes_a_batch_last_longer():
    hits = "xxxxxxxx" + "x..." * 18
    assert polished(hits, batch=8) < polished(hits, batch=400)
