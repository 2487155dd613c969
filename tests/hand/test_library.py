"""Finding hands by name or path."""

import shutil

import pytest

from xdex_drake.data_files import data_folder
from xdex_drake.errors import ConfigError, HandFileError, UnknownHand, XdexError
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.yaml_file import hand_digest


def test_names_are_the_files() -> None:
    assert list_hands() == tuple(sorted(list_hands()))
    for name in list_hands():
        assert load_hand(name).name == name


def test_a_path_gives_the_same_hand(tmp_path) -> None:
    copy = tmp_path / "mine.yaml"
    shutil.copy(data_folder("hands") / "allegro.yaml", copy)
    assert hand_digest(load_hand(copy)) == hand_digest(load_hand("allegro"))
    assert hand_digest(load_hand(str(copy))) == hand_digest(load_hand("allegro"))


def test_an_unknown_name_lists_close_ones() -> None:
    with pytest.raises(UnknownHand, match="did you mean allegro"):
        load_hand("Allegra")
    with pytest.raises(UnknownHand, match="known are ability, allegro"):
        load_hand("qqqq")


@pytest.mark.parametrize("name", ["hand.urdf", "some/where/hand.xml", "HAND.URDF", "hand.sdf"])
def test_an_absent_robot_file_is_one_error(name) -> None:
    with pytest.raises(HandFileError, match="no such file"):
        load_hand(name)


@pytest.mark.parametrize("name", ["hand.obj", "some/where/hand", "../allegro"])
def test_other_files_are_refused(name) -> None:
    with pytest.raises(HandFileError, match="no hand file"):
        load_hand(name)


def test_an_absent_file_is_one_error_of_the_family() -> None:
    with pytest.raises(XdexError, match=r"absent\.yaml"):
        load_hand("absent.yaml")


def test_data_folders() -> None:
    assert (data_folder("hands") / "allegro.yaml").is_file()
    assert data_folder("problems").name == "problems"
    with pytest.raises(ConfigError, match="hands, problems"):
        data_folder("objects")
