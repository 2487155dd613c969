import pytest

from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="session")
def allegro():
    return load_hand("allegro")


@pytest.fixture(scope="session")
def box_scene():
    return make_scene(load_object("box"))


@pytest.fixture(scope="session")
def can_scene():
    return make_scene(load_object("can"))
