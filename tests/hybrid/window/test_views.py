"""What the window shows of a frame, warped to the newest camera if it is late."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from compose.fovea.samples import Samples
from compose.image.colour import bytes_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.render.fovea import FoveaImage
from hybrid.render.frame import Frame
from hybrid.render.frame_settings import FrameSettings
from hybrid.window import window_views as views
from hybrid.window.frame_source import SceneSource
from hybrid.window.messages import Request, ShownFrame, ShownView
from hybrid.window.window_views import image_of, late_warped
from tests import small
from tests.compose.arrays_of import image_on
from tests.hybrid.window.fakes import moved

pytestmark = pytest.mark.usefixtures("backend")
H, W = 24, 32


def frame(composite: np.ndarray | None = None) -> Frame:
    """A frame of noise or with the given composite, and with a disc in its middle."""
    rng, arrays = small.rng(), device_arrays()
    region = Foveation(Gaze(0.5, 0.5), 40.0, 20.0).region(W, H)
    noise = lambda *shape: rng.uniform(0, 1, shape).astype(np.float32)  # noqa: E731
    disc = region.disc(arrays)
    radiance = [arrays.plain.Float(noise(region.count)) for _ in range(3)]
    nothing: Any = None
    return Frame(
        image=image_on(arrays, noise(H, W, 3) if composite is None else composite),
        settings=FrameSettings(),
        camera=nothing,
        behind=[arrays.plain.Float(noise(region.count)) for _ in range(3)],
        detail=nothing,
        nodes_drawn=0,
        fovea=FoveaImage(disc, radiance, Samples.none(arrays, disc.pixels)),
        underlay=None,
        region=region,
        milliseconds={},
    )


def traced(image: np.ndarray) -> Any:
    """A path-traced frame with a noisy image, and half of it when denoised."""
    return SimpleNamespace(image=lambda: image, denoised=lambda: image / 2)


def test_composite_and_periphery_are_shown_as_they_are():
    made = frame()
    assert (image_of(ShownView.COMPOSITE, made, None) == bytes_from_radiance(made.composite)).all()
    assert (image_of(ShownView.PERIPHERY, made, None) == bytes_from_radiance(made.periphery)).all()
    expected = made.composite.copy().reshape(-1, 3)
    expected[np.array(made.fovea.disc.pixels)] = np.stack(made.behind, axis=1)
    np.testing.assert_array_equal(made.periphery, expected.reshape(H, W, 3))


def test_any_radiance_becomes_a_byte():
    composite = frame().composite.copy()
    composite[0, 0] = [np.nan, np.inf, -1]
    composite[0, 1] = [0.0031308, 5e-4, 7]
    made = frame(composite)
    with np.errstate(invalid="ignore"):
        expected = bytes_from_radiance(np.nan_to_num(composite, nan=0, posinf=1))
    assert np.abs(image_of(ShownView.COMPOSITE, made, None).astype(int) - expected).max() <= 1
    assert (image_of(ShownView.COMPOSITE, made, None)[0, 0] == [0, 255, 0]).all()


def test_the_kernel_has_the_curve_of_srgb():
    composite = np.linspace(0, 0.02, H * W * 3, dtype=np.float32).reshape(H, W, 3)
    # Known pairs of IEC 61966-2-1: linear 0.0030 is byte 10, 0.0152 byte 33, 0.2140 byte 127, 0.5 byte 188.
    composite[0, :4, 0] = [0.00304, 0.0152, 0.2140, 0.5]
    assert image_of(ShownView.COMPOSITE, frame(composite), None)[0, :4, 0].tolist() == [10, 33, 127, 188]


def test_the_fovea_alone_fades_out_in_the_band():
    made = frame()
    image = image_of(ShownView.FOVEA, made, None).reshape(-1, 3)
    pixels, weights = made.region.pixels, made.region.weight_image().ravel()
    outside = np.setdiff1d(np.arange(H * W), pixels)
    assert not image[outside].any()
    expected = bytes_from_radiance(made.of_disc(made.fovea.radiance)).reshape(-1, 3)
    full = weights == 1
    assert full.any()
    assert (image[full] == expected[full]).all()
    band = (weights > 0) & (weights < 1)
    ratio = image[band].sum() / expected[band].sum()
    assert 0.3 < ratio < 0.9


def test_the_split_view_has_each_image_on_its_side():
    made, other = frame(), np.full((H, W, 3), 0.3, dtype=np.float32)
    image = image_of(ShownView.SPLIT, made, traced(other))
    assert (image[:, : W // 2] == bytes_from_radiance(made.composite)[:, : W // 2]).all()
    assert (image[:, W // 2] == 255).all()
    assert (image[:, W // 2 + 1 :] == bytes_from_radiance(other)[:, W // 2 + 1 :]).all()
    assert (image_of(ShownView.PATH_TRACED, made, traced(other)) == bytes_from_radiance(other)).all()


def test_a_difference_is_dark_where_there_is_none_and_brighter_the_larger_it_is():
    made = frame()
    # The difference is from the denoised frame.
    assert not image_of(ShownView.DIFFERENCE, made, traced(2 * made.composite)).any()
    made = frame(np.full((H, W, 3), 0.5, dtype=np.float32))
    ramp = np.repeat(np.linspace(0.5, 1, W, dtype=np.float32)[None, :, None], 3, axis=2).repeat(H, axis=0)
    heat = image_of(ShownView.DIFFERENCE, made, traced(2 * ramp))
    brightness = heat.astype(int).sum(axis=2)[0]
    assert (np.diff(brightness) >= 0).all()
    assert brightness[0] == 0
    assert brightness[-1] > 500
    # Red comes first, then green, then blue.
    assert (heat[..., 0] >= heat[..., 1]).all()
    assert (heat[..., 1] >= heat[..., 2]).all()
    assert (heat[0, :, 1] > 0).any()


def test_differences_from_a_quarter_on_are_white():
    # In sRGB 0.5 and 0.76, or 0.74: just above and below a quarter.
    made = frame(np.full((H, W, 3), 0.2140, dtype=np.float32))
    for other, white in ((0.539, True), (0.507, False)):
        heat = image_of(ShownView.DIFFERENCE, made, traced(np.full((H, W, 3), 2 * other, dtype=np.float32)))
        assert (heat == 255).all() == white


def test_levels_are_drawn_from_composite_detail_and_region(monkeypatch):
    made = frame()
    monkeypatch.setattr(views, "levels_picture", lambda *parts: parts)
    composite, detail, region = image_of(ShownView.LEVELS, made, None)
    np.testing.assert_array_equal(composite, made.composite)
    assert detail is made.detail
    assert region is made.region


def test_a_view_that_needs_a_path_traced_frame_says_so():
    for view in (ShownView.PATH_TRACED, ShownView.SPLIT, ShownView.DIFFERENCE):
        with pytest.raises(ValueError, match="needs the path-traced frame"):
            image_of(view, frame(), None)


def no_depths(camera: Camera) -> NoReturn:
    pytest.fail("nobody has moved")


def shown_from(source: SceneSource, camera: Camera, **settings: Any) -> ShownFrame:
    """The splats of a view: without noise."""
    base = FrameSettings(gaze=Gaze(0.5, 0.5), fov_a=2.0, fov_b=1.0, spp=1, camera=camera, **settings)
    return source.show(Request(base, ShownView.PERIPHERY), True)


def decibels(one: ShownFrame, other: ShownFrame) -> float:
    difference = one.image.astype(np.float64) - other.image
    return float(-10 * np.log10(np.mean((difference / 255) ** 2)))


@pytest.fixture
def camera(source) -> Camera:
    view: Camera = source.camera.resized(160, 120)
    return view


def test_a_frame_of_the_newest_camera_is_shown_as_it_is(source, camera):
    late = shown_from(source, camera)
    assert late_warped(late, replace(camera), no_depths) is late


@pytest.mark.parametrize(("right", "degrees"), [(0.08, 0.0), (0.0, 3.0), (-0.05, 1.5)])
def test_a_late_frame_comes_closer_to_what_is_seen_now(source, camera, right, degrees):
    newest = moved(camera, right * source.ready().distance, degrees)
    late = shown_from(source, camera)
    warped = source.warped(late, newest)
    expected = shown_from(source, newest)
    assert decibels(warped, expected) > decibels(late, expected) + 4


def test_the_warp_is_a_pass_of_the_frame(source, camera):
    late = shown_from(source, camera)
    warped = late_warped(late, moved(camera, degrees=2.0), no_depths)
    assert (warped.image.dtype, warped.image.shape) == (np.uint8, (120, 160, 3))
    assert [*warped.milliseconds][-2:] == ["warp", "total"]
    added = warped.milliseconds["total"] - late.milliseconds["total"]
    assert added == pytest.approx(warped.milliseconds["warp"])
    assert {**late.milliseconds, **warped.milliseconds} == warped.milliseconds
    assert replace(warped, image=late.image, milliseconds=late.milliseconds) == late


def test_a_frame_of_half_the_size_keeps_it(source, camera):
    late, newest = shown_from(source, camera, scale=0.5), moved(camera, degrees=3.0)
    assert late.image.shape == (60, 80, 3)
    warped, expected = late_warped(late, newest, no_depths), shown_from(source, newest, scale=0.5)
    assert decibels(warped, expected) > decibels(late, expected) + 4
