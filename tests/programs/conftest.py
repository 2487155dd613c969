import pytest

from xdex_drake.hand.library import load_hand
from xdex_drake.programs.force_closure import program_of_candidate
from xdex_drake.programs.search import search
from xdex_drake.programs.solve import solve
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


@pytest.fixture(scope="session")
def found(allegro, can_scene):
    return search(allegro, can_scene, count=24, seed=0)


@pytest.fixture(scope="session")
def solved(allegro, can_scene, found):
    for row in range(10):
        result = solve(program_of_candidate(allegro, can_scene, found, row))
        if result.success:
            return row, result
    pytest.fail("none of ten candidates could be polished")
