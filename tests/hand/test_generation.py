"""Generated hands: from a name alone, the same everywhere, sound, and never one of the originals."""

import dataclasses
import json

import numpy as np
import pytest

from xdex_drake.errors import ConfigError, UnknownHand
from xdex_drake.hand.checks import ACTUATED, LINKS, SIZE, check_hand, hand_size
from xdex_drake.hand.generation import (
    BASES,
    generate_hand,
    generated_hand,
    hand_name,
    read_hand_name,
    topology,
)
from xdex_drake.hand.human import human_hand
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.variation import apply_operations, duplicate_link, read_operations, scale_hand
from xdex_drake.hand.yaml_file import hand_digest, read_hand
from xdex_drake.jobs.hands import generate_hands, read_hand_rows


@pytest.fixture(scope="module")
def some() -> list:
    return [generate_hand(0, index) for index in range(20)]


def test_every_fifth_is_human(some) -> None:
    assert [made.base == "human" for made in some] == [index % 5 == 0 for index in range(20)]
    assert {made.base for made in some} - {"human"} <= set(BASES)


def test_all_are_sound(some) -> None:
    for made in some:
        hand = made.hand
        assert check_hand(hand) == ()
        assert LINKS[0] <= len(hand.links) <= LINKS[1]
        assert ACTUATED[0] <= len(hand.joint_names) <= ACTUATED[1]
        assert SIZE[0] <= hand_size(hand) <= SIZE[1]


def test_they_differ(some) -> None:
    assert len({topology(made.hand) for made in some}) >= 12
    assert len({hand_digest(dataclasses.replace(made.hand, name="x")) for made in some}) == 20


def test_the_originals_are_never_among_them(some) -> None:
    originals = {name: load_hand(name) for name in BASES}
    digests = {hand_digest(dataclasses.replace(hand, name="x")) for hand in originals.values()}
    for made in some:
        assert hand_digest(dataclasses.replace(made.hand, name="x")) not in digests
        if made.base == "human":
            continue
        # By construction: the last operation scales what it touches by 3 % or more.
        last = made.operations[-1]
        assert last.kind in ("scale_hand", "scale_links")
        assert all(abs(factor - 1.0) >= 0.03 for factor in last.factors)
        sizes = {g: shape for g, shape in ((k.name, k.geometry) for k in originals[made.base].links)}
        assert any(repr(k.geometry) != repr(sizes.get(k.name)) for k in made.hand.links)


def test_provenance_reproduces_a_hand(some) -> None:
    for made in some:
        if made.base != "human":
            again = apply_operations(load_hand(made.base), read_operations(made.hand.sources["variation"]))
            again = dataclasses.replace(again, name=made.hand.name, q_rest=made.hand.q_rest)  # the rest may be mended
            assert hand_digest(again) == hand_digest(made.hand)
            assert made.hand.sources["base"] == made.base
        else:
            assert made.hand.sources["base"].startswith("human(hand_length 0.")


def test_names_round_trip() -> None:
    for seed, index in ((0, 0), (0, 137), (12, 9999), (3, 12345)):
        assert read_hand_name(hand_name(seed, index)) == (seed, index)
    for name in ("g0-137", "g00-0137", "g0-00137", "h0-0137", "g-0137", "allegro", "g0-0137.yaml", "g0_0137"):
        assert read_hand_name(name) is None
    with pytest.raises(ConfigError, match="index"):
        generated_hand(0, -1)


def test_the_library_loads_them_by_name(some) -> None:
    assert load_hand("g0-0007").name == "g0-0007"
    assert hand_digest(load_hand("g0-0007")) == hand_digest(some[7].hand)
    with pytest.raises(UnknownHand):
        load_hand("g0-137")


def test_files_are_the_same_whatever_the_workers(tmp_path) -> None:
    a, b = tmp_path / "a", tmp_path / "b"
    rows = generate_hands(12, 4, a, workers=0)
    assert generate_hands(12, 4, b, workers=1) == rows
    names = sorted(path.name for path in a.iterdir())
    assert names == sorted([*(f"g4-{k:04d}.yaml" for k in range(12)), "index.json"])
    for name in names:
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
    hand = read_hand(a / "g4-0003.yaml")
    assert hand_digest(hand) == hand_digest(generated_hand(4, 3))
    assert read_hand_rows(a) == rows


def test_goes_on_where_it_was_interrupted(tmp_path) -> None:
    whole = generate_hands(12, 4, tmp_path / "whole", workers=0)

    class Stop(Exception):
        pass

    def stop(done: int) -> None:
        if done:
            raise Stop

    folder = tmp_path / "part"
    with pytest.raises(Stop):
        generate_hands(12, 4, folder, workers=0, on_done=stop)
    assert not (folder / "index.json").exists()
    # A kill may cut off the last line of the journal.
    journal = next(path for path in folder.iterdir() if path.suffix == ".jsonl")
    journal.write_text(journal.read_text() + '{"name": "g4-00')
    before = {path.name: path.stat().st_mtime_ns for path in folder.glob("*.yaml")}
    counts = []
    assert generate_hands(12, 4, folder, workers=0, on_done=counts.append) == whole
    assert counts[0] == 10
    assert all((folder / name).stat().st_mtime_ns == time for name, time in before.items())
    assert (folder / "index.json").read_bytes() == (tmp_path / "whole" / "index.json").read_bytes()
    assert not journal.exists()


def test_another_set_is_refused(tmp_path) -> None:
    generate_hands(1, 4, tmp_path, workers=0)
    with pytest.raises(ConfigError, match="seed 4"):
        generate_hands(1, 5, tmp_path, workers=0)
    (tmp_path / "index.json").write_text(json.dumps({"hands": 3}))
    with pytest.raises(ConfigError, match="no index"):
        generate_hands(1, 4, tmp_path, workers=0)
    with pytest.raises(ConfigError, match="count"):
        generate_hands(0, 4, tmp_path)


def test_topology_ignores_names_sizes_and_order() -> None:
    hand = load_hand("inspire")
    tree = topology(hand)
    assert topology(scale_hand(hand, 1.1)) == tree
    renamed = human_hand()
    swapped = dataclasses.replace(renamed, joints=renamed.joints[4:] + renamed.joints[:4])
    swapped = dataclasses.replace(swapped, links=(renamed.links[0], *renamed.links[5:], *renamed.links[1:5]))
    assert topology(swapped) == topology(renamed)
    free = duplicate_link(hand, "index_proximal")
    coupled = duplicate_link(hand, "index_proximal", coupled=True)
    middle = duplicate_link(hand, "middle_proximal")
    assert len({tree, topology(free), topology(coupled)}) == 3
    assert topology(free) == topology(middle)


def test_couplings_count() -> None:
    assert topology(load_hand("inspire")) == "(" + "r(r(r1(r2())))" + "r(r1())" * 4 + ")"
    assert np.all([topology(load_hand(name)).count("(") == len(load_hand(name).links) for name in BASES])
