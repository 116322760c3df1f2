"""What a forest does not know is path-traced, at the ends: nothing, everything, the sky."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.camera.camera import Camera, turned
from hybrid.measure.image_metrics import psnr
from hybrid.render.forest_attachments import attach_views, views_of
from hybrid.render.frame_renderer import LiveRenderer, Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.hole_filling import KnownSurfaces
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import radiance_image
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.extremes import extreme
from tests.hybrid.forests import rough_forest, white_dot

PERIPHERY = FrameSettings(fov_a=0, fov_b=0, acuity_model="none", integrator="path")


def turned_camera(camera: Camera, yaw: float) -> Camera:
    pose = camera.camera_to_world.copy()
    pose[:3, :3] = turned(pose[:3, :3], yaw, 0)
    inverse = np.linalg.inv(pose)
    return replace(camera, world_to_camera=inverse)


@pytest.fixture(scope="module")
def room(backend):
    """A closed sphere whose radiance is 1 everywhere."""
    return load_scene(small.furnace())


@pytest.fixture(scope="module")
def view(room) -> Camera:
    return room.camera.resized(100, 76)


@pytest.fixture(scope="module")
def unknown(room, view):
    """Renders with a forest that was trained on views in the other direction."""
    forest = attach_views(white_dot((0, 0, 30)), [turned_camera(view, 180)])
    return Renderer(room, replace(forest, scene_name=room.name, scene_hash=room.hash))


@extreme(
    "a view that no training view saw",
    given="a closed sphere of radiance 1, one training view turned by 180 degrees",
    expected="all filled, mean radiance within 3 % of 1",
)
def test_a_view_that_is_not_known_at_all_is_filled(unknown, view, got):
    frame = unknown.frame(replace(PERIPHERY, camera=view), 3)
    assert got(frame.filled) == 1
    assert got(float(frame.composite.mean()), ".3f") == pytest.approx(1, abs=0.03)
    assert frame.composite.min() > 0.3
    assert (frame.aovs()["coverage"] == 0).all()
    again = unknown.frame(replace(PERIPHERY, camera=view), 3)
    np.testing.assert_array_equal(again.composite, frame.composite)
    other = unknown.frame(replace(PERIPHERY, camera=view), 4)
    assert (other.composite != frame.composite).any()


def test_it_stays_dark_where_the_settings_say_so(unknown, view):
    frame = unknown.frame(replace(PERIPHERY, camera=view, fill=False))
    assert frame.fill is None
    assert frame.composite.max() < 0.1


def test_a_fused_fovea_has_it_below(unknown, view):
    frame = unknown.frame(replace(PERIPHERY, camera=view, fov_a=30, fov_b=20, spp=1))
    assert frame.underlay.radiance.numpy()[frame.region.box].min() > 0.3


def test_half_of_a_view_is_filled_and_the_other_half_is_the_splats(scene, forest):
    camera = scene.camera.resized(160, 96)
    known = attach_views(forest, [turned_camera(scene.camera.resized(160, 160), -40)])
    renderer = Renderer(scene, known)
    frame = renderer.frame(replace(PERIPHERY, camera=camera))
    splats = renderer.splats(frame.settings)
    coverage = frame.aovs()["coverage"]
    assert 0.1 < frame.filled < 0.9
    assert frame.filled == pytest.approx(1 - coverage.mean(), abs=1e-4)
    np.testing.assert_array_equal(frame.composite[coverage == 1], splats[coverage == 1])
    reference = radiance_image(renderer.tracer, camera, frame_positions(camera), 160, 64, 9)
    filled = coverage == 0
    assert psnr(frame.composite[filled][None], reference[filled][None]) > 25


@extreme(
    "a view that a forest knows all of",
    given="the view of its training",
    expected="nothing traced, the same frame bit by bit",
)
def test_nothing_is_traced_where_all_is_known(scene, forest, monkeypatch, got):
    renderer = Renderer(scene, forest)
    monkeypatch.setattr(renderer, "tracer_of", None)
    monkeypatch.setattr(renderer, "fovea_of", Renderer(scene, forest).fovea_of)
    plain = renderer.frame(replace(PERIPHERY, fill=False))
    frame = renderer.frame(PERIPHERY)
    np.testing.assert_array_equal(frame.composite, plain.composite)
    assert got(frame.filled) == 0
    assert (frame.aovs()["coverage"] == 1).all()


def test_finer_frames_of_one_place_make_no_other_unknown(scene, forest):
    """Splats show what coarse frames saw as they would without the finer one."""
    views = views_of(forest)
    width, height = views[0].width, views[0].height
    finer = turned_camera(views[0].resized(4 * width, 4 * height).cropped(0, 0, width, height), 180)
    refined = replace(forest, trained_focal=4 * forest.trained_focal)
    refined = attach_views(refined, [*views, *views, *views, finer])
    assert Renderer(scene, refined).frame(PERIPHERY).filled == 0


@pytest.mark.parametrize(
    ("sky", "share"),
    [
        pytest.param(
            None,
            0.0,
            marks=extreme("an unknown view of nothing", given="no sky, nothing hit", expected="none filled"),
        ),
        pytest.param(
            0.7,
            1.0,
            marks=extreme("an unknown view of the sky", given="radiance 0.7", expected="all filled, 0.7"),
        ),
    ],
)
def test_where_nothing_is_hit_only_a_sky_is_filled(backend, sky, share, got):
    description = small.corner()
    if sky is not None:
        description["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": sky}}
    scene = load_scene(description)
    camera = turned_camera(scene.camera, 180)
    forest = attach_views(rough_forest(scene), [scene.camera])
    frame = Renderer(scene, forest).frame(replace(PERIPHERY, camera=camera))
    assert got(frame.filled) == share
    if sky is not None:
        np.testing.assert_allclose(got(float(frame.composite.mean()), ".3f"), sky, atol=0.01)


def test_a_forest_that_does_not_name_its_views_is_judged_by_its_opacity(room, view, arrays):
    dot = white_dot((0.1, 0, 0.4), opacity_logit=9)
    dot.finest.log_scales[:] = np.log(0.3)
    # The dot is in the middle.
    known = KnownSurfaces(arrays, dot).of(view.resized(640, 640), Tracer(room))
    assert known.shape == (40, 40)
    assert known[20, 20] > 0.5
    assert known[:8].max() == 0


def test_a_window_keeps_what_it_filled_until_the_camera_moves(room, view, unknown):
    live = LiveRenderer(room, unknown.periphery.forest)
    settings = replace(PERIPHERY, camera=view, fov_a=20, fov_b=10, spp=1, fovea="fused")
    moving, first, second = (live.frame(settings, seed) for seed in range(3))
    assert first.fill is second.fill
    assert first.fill is not moving.fill
    for frame in (moving, second):
        assert frame.composite.mean() == pytest.approx(1, abs=0.1)
    other = live.frame(replace(settings, camera=turned_camera(view, 5)), 3)
    assert other.fill is not second.fill
    refined = live.refined(second, 1, 9, quick=True)
    assert refined.filled == 1
    live.lights_changed()
    live.frame(settings, 4)
    assert live.frame(settings, 5).fill is not second.fill
