"""Foveas of scenes at their ends, over splats that are broken, with fireflies and in frames of any shape."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import mitsuba as mi
import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.fovea.disc import Disc
from compose.fovea.foveation import FoveaMode, Foveation
from compose.image.device_image import DeviceImage
from hybrid.base.compute_device import device_arrays
from hybrid.render.disc_images import Underlay
from hybrid.render.disc_tracer import DiscRequest, DiscTracer
from hybrid.render.fovea import Fovea
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.compose.arrays_of import channels, host, image_on, numbers
from tests.extremes import extreme

pytestmark = pytest.mark.usefixtures("backend")

SIDE = 32
REGION = Foveation(Gaze(), 45, 30).region(SIDE, SIDE)


def lamp(radiance: float, scale: float = 0.7) -> dict:
    place = mi.ScalarTransform4f().look_at(origin=[0, 2.5, -1], target=[0, 0, 1], up=[0, 0, 1]).scale(scale)
    glow = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return {"type": "rectangle", "to_world": place, "emitter": glow}


def damaged() -> dict:
    """A texture with texels that are not numbers."""
    texels = np.full((4, 4, 3), 0.5, np.float32)
    texels[1:3, 1:3] = np.nan
    image = {"type": "bitmap", "bitmap": mi.Bitmap(texels), "raw": True, "filter_type": "nearest"}
    return {"type": "twosided", "b": {"type": "diffuse", "reflectance": image}}


def mirror() -> dict:
    place = mi.ScalarTransform4f().translate([0, 0, 0.5]).rotate([0, 1, 0], 180).scale(50)
    return {"type": "rectangle", "to_world": place, "bsdf": {"type": "conductor"}}


SCENES = {
    "NaN texels": lambda plain: plain["back"].update(bsdf=damaged()),
    "a black scene": lambda plain: plain.update(lamp=lamp(0.0)),
    "a lamp of no size": lambda plain: plain.update(lamp=lamp(12.0, 1e-20)),
    "light of 1e-8": lambda plain: plain.update(lamp=lamp(1e-8)),
    "light of 1e6": lambda plain: plain.update(lamp=lamp(1e6)),
    "light of 1e30": lambda plain: plain.update(lamp=lamp(1e30)),
    "a mirror that fills the view": lambda plain: plain.update(mirror=mirror()),
}


def even(value: float, spot: float | None = None) -> DeviceImage:
    """A frame of one value, with another one in its middle."""
    image = np.full((SIDE, SIDE, 3), value, np.float32)
    if spot is not None:
        image[16, 16] = spot
    return image_on(device_arrays(), image)


def underlay(camera, value: float = 0.3, spot: float | None = None) -> Underlay:
    return Underlay(camera, even(value, spot))


@pytest.fixture
def disc(arrays) -> Disc:
    return REGION.disc(arrays)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=extreme(f"foveas: {name}", given="each mode, 4 spp, 1 and 2 frames", expected="finite"),
        )
        for name in SCENES
    ],
)
def test_foveas_of_extreme_scenes_are_finite(name, disc, got):
    description = small.corner()
    SCENES[name](description)
    scene = load_scene(description)
    tracer, camera, brightest = Tracer(scene), scene.camera, []
    for mode, history in product(FoveaMode, (False, True)):
        fovea = Fovea(tracer, history=history)
        for frame in range(1 + history):
            traced, samples = fovea.trace(mode, camera, disc, 4, frame, underlay(camera))
            made = fovea.image(mode, traced, samples, even(0), underlay(camera))
            radiance = host(made.radiance)
            assert np.isfinite(radiance).all()
            assert not np.isnan(numbers(samples, "variance")).any()
            brightest.append(float(radiance.max()))
    assert got(max(brightest), ".2g") >= 0


@pytest.mark.parametrize(
    "value",
    [
        pytest.param(
            v,
            marks=extreme(f"frames over splats of {v:g}", given="one pixel and all", expected="finite disc"),
        )
        for v in (np.nan, np.inf, -1.0, 1e30)
    ],
)
def test_broken_splats_under_the_disc_leave_it_finite(renderer, value, disc, got):
    """From 4 samples per pixel on the splats say where the others go."""
    scene = renderer.scene
    fovea, everywhere = Fovea(renderer.tracer), int(np.prod(disc.shape))
    one, whole = underlay(scene.camera, spot=value), underlay(scene.camera, value)
    for (broken, excluded), spp in product(((one, 1), (whole, everywhere)), (1, 4, 17)):
        traced, samples = fovea.trace(FoveaMode.FUSED, scene.camera, disc, spp, 0, broken)
        count = numbers(samples, "count")
        assert count.sum() == spp * disc.count
        assert count.min() >= 1
        made = fovea.image(FoveaMode.FUSED, traced, samples, None, broken)
        radiance = host(made.radiance)
        assert np.isfinite(radiance).all()
        assert radiance.max() < 100
        assert got(made.excluded) == excluded


@pytest.mark.parametrize("mode", [FoveaMode.DENOISED, FoveaMode.FUSED])
@pytest.mark.parametrize("value", [1e15, 1e30, float(np.finfo(np.float32).max)])
def test_a_firefly_changes_a_disc_only_where_it_is(renderer, value, mode, disc):
    """Against the same samples with what their neighbours show in its pixel."""
    camera, fovea = renderer.scene.camera, Fovea(renderer.tracer)
    traced, samples = fovea.trace(mode, camera, disc, 4, 0, underlay(camera))
    spot = int(np.searchsorted(numbers(samples, "pixels"), 16 * SIDE + 16))
    radiance, squares = numbers(samples, "radiance"), numbers(samples, "squares")
    with np.errstate(over="ignore"):
        radiance[spot], squares[spot] = value / 4, np.float32(value) ** 2 / 4
    light, its_squares = (channels(disc.arrays, of) for of in (radiance, squares))
    given = replace(samples, radiance=light, squares=its_squares)
    plain, bright = (
        host(fovea.image(mode, traced, of, even(0), underlay(camera)).radiance) for of in (samples, given)
    )
    assert np.isfinite(bright).all()
    changed = np.abs(bright - plain).max(axis=1)
    changed[spot] = 0
    # The denoiser sees another sample there; what it makes of this is a small part of what is around it.
    assert changed.max() < 0.1 * plain.max()
    assert np.median(changed) < 1e-3 * plain.max()


def test_the_raw_fovea_keeps_a_firefly(renderer, disc):
    fovea = Fovea(renderer.tracer)
    traced, samples = fovea.trace(FoveaMode.RAW, renderer.scene.camera, disc, 2, 0)
    radiance = numbers(samples, "radiance")
    radiance[7] = 1e30
    given = replace(samples, radiance=channels(disc.arrays, radiance))
    np.testing.assert_array_equal(host(fovea.image(FoveaMode.RAW, traced, given).radiance), radiance)


@extreme("1 and 16,384 spp in a fused fovea", given="a disc of one pixel", expected="as many samples")
def test_discs_of_one_pixel_take_any_number_of_samples(renderer, arrays, got):
    camera = renderer.scene.camera
    pixel = Foveation(Gaze(16.5 / SIDE, 16.5 / SIDE), 2, 2).region(SIDE, SIDE).disc(arrays)
    for spp in (1, 16384):
        request = DiscRequest(camera, pixel, spp, 0)
        samples = DiscTracer(renderer.tracer, history=False).trace(request, underlay(camera))
        assert got(numbers(samples, "count").tolist()) == [spp]
        assert np.isfinite(numbers(samples, "radiance")).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (2, 3)])
@pytest.mark.parametrize("mode", FoveaMode)
def test_frames_of_any_shape_are_finite(renderer, size, mode):
    settings = FrameSettings(fov_a=60, fov_b=20, spp=4, fovea=mode, integrator="path")
    frame = renderer.frame(replace(settings, camera=renderer.scene.camera.resized(*size)), seed=1)
    assert frame.composite.shape == (size[1], size[0], 3)
    assert np.isfinite(frame.composite).all()


@pytest.mark.parametrize("fov_a", [75.0, 80.0, 84.0, 100.0])
def test_neighbouring_radii_give_neighbouring_frames(renderer, fov_a):
    """Where the disc begins to cover the frame as well, at 69 % of the height."""
    settings = FrameSettings(fov_b=15, spp=1, fovea="denoised", integrator="path")
    one, other = (renderer.frame(replace(settings, fov_a=a), seed=1) for a in (fov_a, fov_a + 0.2))
    weights = [frame.weight_image() for frame in (one, other)]
    assert np.abs(weights[0] - weights[1]).max() < 0.02


def test_traced_light_of_any_strength_scales(renderer, disc):
    """The same scene under light 2^80 times as bright has the same samples, 2^80 times as bright."""
    found = []
    for strength in (1.0, 2.0**80):
        description = small.corner()
        description["lamp"] = lamp(strength)
        scene = load_scene(description)
        _, samples = Fovea(Tracer(scene)).trace(FoveaMode.RAW, scene.camera, disc, 2, 0)
        found.append(numbers(samples, "radiance") / np.float32(strength))
    np.testing.assert_allclose(*found, rtol=1e-5)
