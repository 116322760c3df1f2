"""What the window shows of a frame."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from compose.image.colour import bytes_from_radiance
from hybrid.frame.frame import Frame
from hybrid.interactive.pictures import picture_of
from hybrid.interactive.request import Shows
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
H, W = 24, 32


def frame() -> Frame:
    rng = small.rng()
    region = Foveation(Gaze(0.5, 0.5), 40.0, 20.0).region(W, H)
    image = lambda *shape: rng.uniform(0, 1, shape).astype(np.float32)  # noqa: E731
    fovea = SimpleNamespace(radiance=image(len(region.pixels), 3))
    return Frame(image(H, W, 3), image(H, W, 3), fovea, None, region, None, 0, {})  # type: ignore[arg-type]


def test_composite_and_periphery_are_shown_as_they_are():
    made = frame()
    assert (picture_of(Shows.COMPOSITE, made, None) == bytes_from_radiance(made.composite)).all()
    assert (picture_of(Shows.PERIPHERY, made, None) == bytes_from_radiance(made.periphery)).all()


def test_whatever_radiance_there_is_becomes_a_byte():
    made = frame()
    made.composite[0, 0] = [np.nan, np.inf, -1]
    made.composite[0, 1] = [0.0031308, 5e-4, 7]
    with np.errstate(invalid="ignore"):
        expected = bytes_from_radiance(np.nan_to_num(made.composite, nan=0, posinf=1))
    assert np.abs(picture_of(Shows.COMPOSITE, made, None).astype(int) - expected).max() <= 1
    assert (picture_of(Shows.COMPOSITE, made, None)[0, 0] == [0, 255, 0]).all()


def test_the_fovea_alone_fades_out_in_the_band():
    made = frame()
    picture = picture_of(Shows.FOVEA, made, None).reshape(-1, 3)
    outside = np.setdiff1d(np.arange(H * W), made.region.pixels)
    assert not picture[outside].any()
    full = made.region.weights == 1
    assert (picture[made.region.pixels[full]] == bytes_from_radiance(made.fovea.radiance[full])).all()
    band = (made.region.weights > 0) & (made.region.weights < 1)
    assert (picture[made.region.pixels[band]] <= bytes_from_radiance(made.fovea.radiance[band])).all()


def test_the_split_view_has_each_picture_on_its_side():
    made, traced = frame(), np.full((H, W, 3), 0.3, dtype=np.float32)
    picture = picture_of(Shows.SPLIT, made, traced)
    assert (picture[:, : W // 2] == bytes_from_radiance(made.composite)[:, : W // 2]).all()
    assert (picture[:, W // 2] == 255).all()
    assert (picture[:, W // 2 + 1 :] == bytes_from_radiance(traced)[:, W // 2 + 1 :]).all()
    assert (picture_of(Shows.PATH_TRACED, made, traced) == bytes_from_radiance(traced)).all()


def test_a_difference_is_dark_where_there_is_none_and_brighter_the_larger_it_is():
    made = frame()
    traced = made.composite.copy()
    assert not picture_of(Shows.DIFFERENCE, made, traced).any()
    made.composite[:] = 0.5
    traced = np.repeat(np.linspace(0.5, 1, W, dtype=np.float32)[None, :, None], 3, axis=2).repeat(H, axis=0)
    brightness = picture_of(Shows.DIFFERENCE, made, traced).astype(int).sum(axis=2)[0]
    assert (np.diff(brightness) >= 0).all()
    assert brightness[0] == 0
    assert brightness[-1] > 500
