"""The settings of a frame: defaults, other forms of a value, refusals, and what follows from them."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.display import DISPLAYS, Display
from compose.eye.gaze import Gaze, eccentricity
from compose.fovea.foveation import FoveaMode, Foveation, Placement
from hybrid.render.frame_settings import DEFAULTS, EVALUATION, INTERACTIVE, SWEEP, FrameSettings
from pathtrace.trace import Integrator

CAMERA = Camera(np.eye(4), 640, 480, 500.0, 500.0, 320.0, 240.0)
# Each field with a value that is not its default.
OTHERS = {
    "gaze": Gaze(0.5, 0.25),
    "fov_a": 21.0,
    "fov_b": 14.0,
    "spp": 5,
    "fovea": FoveaMode.RAW,
    "acuity_model": "fov-gs",
    "layers": (1, 2),
    "rate": 1,
    "scale": 0.5,
    "display": Display(1920, 1080, 55.0, 100.0),
    "camera": CAMERA,
    "integrator": Integrator.PATH,
    "fill": False,
    "time": 0.5,
    "paths": Placement.WHERE_NEEDED,
    "level": 2.0,
    "gaussians": 1000,
    "level_jod": 9.5,
}


def test_the_defaults_are_those_of_a_single_frame():
    settings = FrameSettings()
    assert settings == DEFAULTS
    assert settings.gaze == Gaze(0.5, 0.5)
    assert (settings.fov_a, settings.fov_b, settings.spp) == (20, 15, 4)
    assert settings.fovea is FoveaMode.FUSED
    assert settings.acuity_model == "fovvideovdp"
    assert (settings.layers, settings.rate, settings.scale, settings.camera) == (None, 0, 1, None)
    assert settings.display == DISPLAYS["desktop"]


@pytest.mark.parametrize(
    ("preset", "changed"),
    [
        (INTERACTIVE, {"fov_a": 15.0, "fov_b": 11.25, "spp": 1}),
        (EVALUATION, {"spp": 1}),
        (SWEEP, {"spp": 1, "fovea": FoveaMode.RAW, "fill": False}),
    ],
)
def test_other_uses_change_few_of_the_defaults(preset, changed):
    assert preset == replace(DEFAULTS, **changed)


@pytest.mark.parametrize("gaze", [(0.4, 0.6), [0.4, 0.6], np.array([0.4, 0.6]), Gaze(0.4, 0.6)])
def test_a_gaze_may_be_a_pair(gaze):
    assert FrameSettings(gaze=gaze).gaze == Gaze(0.4, 0.6)


@pytest.mark.parametrize("mode", FoveaMode)
def test_a_fovea_may_be_named(mode):
    assert FrameSettings(fovea=mode.value).fovea is mode
    assert FrameSettings(fovea=mode).fovea is mode


def test_a_display_may_be_named_or_described_in_a_file(tmp_path):
    file = tmp_path / "wall.json"
    file.write_text(json.dumps({"width": 400, "height": 300, "fov": 60}))
    assert FrameSettings(display="hmd").display == DISPLAYS["hmd"]
    assert FrameSettings(display=str(file)).display == Display(400, 300, 60)
    assert FrameSettings(display=Display(400, 300, 60)).display == Display(400, 300, 60)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"gaze": (0.5, float("nan"))}, r"gaze \(0.5, nan\): must be two finite numbers"),
        ({"gaze": (0.5,)}, r"gaze \(0.5,\): must be two finite numbers"),
        ({"gaze": (0.1, 0.2, 0.3)}, r"gaze \(0.1, 0.2, 0.3\): must be two"),
        ({"gaze": 0.5}, "gaze 0.5: must be two"),
        ({"gaze": ("a", "b")}, r"gaze \('a', 'b'\): must be two"),
        ({"fov_a": -1.0}, "fov-a -1.0: must be a percentage of the height"),
        ({"fov_a": float("nan")}, "fov-a nan: must be"),
        ({"fov_a": float("inf")}, "fov-a inf: must be"),
        ({"fov_b": -1.0}, "fov-b -1.0: must be"),
        ({"fov_b": 20.5}, "fov-b 20.5: must be at most fov-a 20.0"),
        ({"spp": 0}, "spp 0: must be a whole number of samples per pixel, 1 or more"),
        ({"spp": 1.5}, "spp 1.5: must be a whole number"),
        ({"fovea": "sharp"}, "fovea sharp: must be raw, denoised or fused"),
        ({"integrator": "mlt"}, "integrator mlt: must be path or cached"),
        ({"fovea": None}, "fovea None: must be raw, denoised or fused"),
        ({"acuity_model": "blur"}, "acuity model blur"),
        ({"rate": -1}, "rate -1: must be a whole number from 0 to 4"),
        ({"rate": 5}, "rate 5: must be"),
        ({"rate": 0.5}, "rate 0.5: must be a whole number"),
        ({"time": -0.1}, "time -0.1: must be from 0 to 1"),
        ({"time": 1.1}, "time 1.1: must be from 0 to 1"),
        ({"time": float("nan")}, "time nan: must be from 0 to 1"),
        ({"scale": 0.0}, "scale 0.0: must be above 0 and at most 1"),
        ({"scale": 1.01}, "scale 1.01: must be"),
        ({"scale": float("nan")}, "scale nan: must be"),
        ({"display": "wall"}, "display wall: must be desktop, hmd or a JSON file"),
    ],
)
def test_what_makes_no_frame_is_refused_by_name(given, message):
    with pytest.raises(UserError, match=f"^{message}"):
        FrameSettings(**given)


def test_the_ends_of_every_range_are_valid():
    FrameSettings(fov_a=0, fov_b=0)
    FrameSettings(fov_a=500, fov_b=500, spp=1, rate=4, scale=1, gaze=(-3, 7))


def test_the_foveation_is_gaze_and_radii():
    assert FrameSettings(gaze=(0.1, 0.9), fov_a=30, fov_b=10).foveation == Foveation(Gaze(0.1, 0.9), 30, 10)


def test_the_band_keeps_its_share_of_another_radius():
    settings = replace(DEFAULTS, **(OTHERS | {"fov_a": 20.0, "fov_b": 5.0}))
    assert settings.with_radius(40.0) == replace(settings, fov_a=40.0, fov_b=10.0)
    assert settings.with_radius(0.0) == replace(settings, fov_a=0.0, fov_b=0.0)
    assert FrameSettings(fov_a=0.5, fov_b=0.25).with_radius(2.0).fov_b == 1


def test_from_no_radius_at_all_the_disc_is_all_band():
    assert FrameSettings(fov_a=0, fov_b=0).with_radius(30.0) == FrameSettings(fov_a=30.0, fov_b=0.0)


def test_the_rendered_camera_is_that_of_the_settings_or_the_default():
    other = CAMERA.resized(32, 32)
    assert FrameSettings().resolved(other) == (other, FrameSettings(camera=other))
    assert FrameSettings(camera=CAMERA).resolved(other) == (CAMERA, FrameSettings(camera=CAMERA))


def test_a_smaller_scale_has_fewer_pixels_across_the_same_angles():
    settings = FrameSettings(gaze=(0.25, 0.25), scale=0.25, layers=(1, 2), display=Display(800, 600, 50, 90))
    camera, resolved = settings.resolved(CAMERA)
    assert camera == CAMERA.resized(160, 120)
    assert camera.vertical_fov == pytest.approx(CAMERA.vertical_fov)
    assert resolved == replace(settings, camera=camera, scale=1.0, display=Display(200, 150, 50, 90))
    # Degrees from the gaze to the middle of a block of 4 x 4 pixels.
    full = eccentricity(settings.display.viewer(640, 480), settings.gaze)
    blocks = full.reshape(120, 4, 160, 4).mean(axis=(1, 3))
    scaled = eccentricity(resolved.display.viewer(160, 120), resolved.gaze)
    np.testing.assert_allclose(scaled, blocks, atol=0.2)


def test_resolved_settings_stay_as_they_are():
    camera, resolved = FrameSettings(scale=0.5).resolved(CAMERA)
    assert resolved.resolved(CAMERA) == (camera, resolved)


def test_a_scaled_frame_has_a_pixel_at_least():
    tiny = CAMERA.resized(3, 1)
    camera, resolved = FrameSettings(scale=0.1, display=Display(4, 3, 50)).resolved(tiny)
    assert (camera.width, camera.height) == (1, 1)
    assert (resolved.display.width, resolved.display.height) == (1, 1)


def test_sides_are_rounded_to_whole_pixels():
    camera, _ = FrameSettings(scale=0.75).resolved(CAMERA.resized(101, 62))
    assert (camera.width, camera.height) == (76, 46)


def test_every_field_changes_what_json_has():
    """Except which AOVs are rendered besides: the picture is the same."""
    names = {field.name for field in fields(FrameSettings)} - {"aovs"}
    assert {*OTHERS} == names == {*DEFAULTS.as_json()}
    texts = {json.dumps(DEFAULTS.as_json())}
    texts |= {json.dumps(replace(DEFAULTS, **{name: other}).as_json()) for name, other in OTHERS.items()}
    assert len(texts) == 1 + len(OTHERS)


def test_json_says_the_values_as_they_are_given():
    found = replace(DEFAULTS, **OTHERS).as_json()
    assert json.loads(json.dumps(found)) == found
    assert found["gaze"] == [0.5, 0.25]
    assert found["fovea"] == "raw"
    assert found["layers"] == [1, 2]
    assert found["display"] == {"width": 1920, "height": 1080, "fov": 55.0, "luminance": 100.0}
    assert (found["fov_a"], found["fov_b"], found["spp"], found["rate"], found["scale"]) == (
        21,
        14,
        5,
        1,
        0.5,
    )


def test_cameras_that_differ_in_one_number_differ_in_json():
    near = replace(CAMERA, fx=np.nextafter(CAMERA.fx, 501))
    assert FrameSettings(camera=near).as_json() != FrameSettings(camera=CAMERA).as_json()
    assert FrameSettings(camera=replace(CAMERA)).as_json() == FrameSettings(camera=CAMERA).as_json()


@pytest.mark.parametrize(
    ("fovea", "integrator", "unbiased"),
    [
        ("raw", "path", True),
        ("raw", None, True),
        ("raw", "cached", False),
        ("denoised", "path", False),
        ("fused", None, False),
    ],
)
def test_only_raw_samples_of_the_path_integrator_are_unbiased(fovea, integrator, unbiased):
    assert FrameSettings(fovea=fovea, integrator=integrator).is_unbiased is unbiased


@pytest.mark.parametrize(
    ("fovea", "given", "used"),
    [
        ("raw", None, "path"),
        ("denoised", None, "cached"),
        ("fused", None, "cached"),
        ("fused", "path", "path"),
    ],
)
def test_paths_end_early_in_foveas_that_are_biased_anyway(fovea, given, used):
    settings = FrameSettings(fovea=fovea, integrator=given)
    assert settings.used_integrator is Integrator(used)
    assert settings.as_json()["integrator"] == used


def test_numbers_of_numpy_are_numbers():
    given = FrameSettings(spp=np.int64(2), rate=np.uint8(1), fov_a=np.float32(25), gaze=np.array([0.4, 0.6]))
    assert (given.spp, given.rate, given.fov_a, given.gaze) == (2, 1, 25.0, Gaze(0.4, 0.6))
    assert [type(value) for value in (given.spp, given.rate, given.fov_a)] == [int, int, float]
    json.dumps(given.as_json())
    with pytest.raises(UserError, match="spp 0: must be a whole number"):
        FrameSettings(spp=np.int64(0))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"level": 0.0}, "level 0: must be over 0 and at most 100"),
        ({"level": float("nan")}, "level nan: must be over 0"),
        ({"level": 101.0}, "level 101: must be"),
        ({"gaussians": 0}, "gaussians 0: must be a whole number"),
        ({"gaussians": 10.5}, "gaussians 10.5: must be a whole number"),
        ({"level_jod": 10.0}, "level_jod 10: must be over 0 and below 10"),
        ({"level_jod": 0.0}, "level_jod 0: must be over 0"),
        ({"level_jod": float("nan")}, "level_jod nan: must be over 0"),
    ],
)
def test_levels_out_of_range_are_named(given, said):
    with pytest.raises(UserError, match=said):
        FrameSettings(**given)


def test_levels_are_continuous_where_they_or_a_number_are_given():
    assert not DEFAULTS.is_continuous
    assert FrameSettings(level=1.0).is_continuous
    assert FrameSettings(gaussians=5000).is_continuous
    assert FrameSettings(level_jod=9.5).is_continuous
