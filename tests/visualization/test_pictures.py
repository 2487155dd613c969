import colorsys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError, MissingExtra
from xdex_drake.scene.materials import object_color
from xdex_drake.visualization import pictures
from xdex_drake.visualization.pictures import (
    CLEAR_COLOR,
    FOV_Y,
    can_render,
    contact_sheet,
    make_studio,
    take_picture,
)
from xdex_drake.visualization.views import best_view


@pytest.fixture(scope="module")
def studio(hand, scene):
    if not can_render():
        pytest.skip("this machine cannot render pictures")
    return make_studio(hand, scene)


def share_of_hue(picture, color, tolerance=8):
    """Share of pixels with a color's hue (tolerance in 1/256 of a turn) that are clearly colored."""
    hsv = np.asarray(Image.fromarray(picture).convert("HSV")).astype(int)
    hue = round(255 * colorsys.rgb_to_hsv(*color)[0])
    gap = np.abs((hsv[..., 0] - hue + 128) % 256 - 128)
    return float(((gap < tolerance) & (hsv[..., 1] > 60) & (hsv[..., 2] > 40)).mean())


def test_picture_shows_hand_object_and_table(studio, grasp, hand, scene):
    picture = take_picture(studio, grasp, size=(240, 180))
    assert picture.shape == (180, 240, 3)
    assert picture.dtype == np.uint8
    assert share_of_hue(picture, object_color("can")) > 0.02
    view = best_view(grasp, hand, scene, fov_y=FOV_Y, aspect=4 / 3)
    away = replace(grasp, X_WH=RigidTransform([0.0, 0.0, 5.0]))
    without = take_picture(studio, away, size=(240, 180), X_WC=view)
    assert (np.abs(picture.astype(int) - without).max(axis=2) > 40).mean() > 0.04
    # Not washed out, not dark.
    assert 60 < picture.mean() < 225
    assert (picture.min(axis=2) >= 254).mean() < 0.05


def test_pictures_of_one_studio_do_not_depend_on_each_other(studio, grasp):
    first = take_picture(studio, grasp, size=(96, 72))
    other = take_picture(studio, replace(grasp, q=grasp.q + 0.3), size=(96, 72))
    again = take_picture(studio, grasp, size=(96, 72))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_camera_may_be_given(studio, grasp):
    from xdex_drake.visualization.views import look_at

    up = take_picture(studio, grasp, size=(32, 24), X_WC=look_at(np.array([0.5, 0.0, 0.5]), np.array([1.0, 0.0, 0.9])))
    np.testing.assert_allclose(up.mean(axis=(0, 1)) / 255.0, CLEAR_COLOR, atol=0.01)


def test_machine_that_cannot_render_is_told_so(monkeypatch, hand, scene):
    monkeypatch.setattr(pictures, "can_render", lambda: False)
    with pytest.raises(MissingExtra, match="libegl1"):
        make_studio(hand, scene)


def test_probe_that_dies_means_no_rendering(monkeypatch):
    monkeypatch.setattr(pictures, "_PROBE", "import os; os.abort()")
    can_render.cache_clear()
    try:
        assert not can_render()
    finally:
        can_render.cache_clear()


def test_contact_sheet_keeps_the_pictures():
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (60, 80, 3), dtype=np.uint8) for _ in range(3)]
    sheet = contact_sheet(images, ["one", "two", "three"], columns=2)
    assert sheet.shape[1] == 160
    room = sheet.shape[0] // 2 - 60
    np.testing.assert_array_equal(sheet[:60, 80:], images[1])
    np.testing.assert_array_equal(sheet[60 + room : 120 + room, :80], images[2])
    assert (sheet[60 : 60 + room, :80] < 128).any()  # a label
    with pytest.raises(ConfigError, match="label for each"):
        contact_sheet(images, ["one"])
    with pytest.raises(ConfigError):
        contact_sheet([], [])
