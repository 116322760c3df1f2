"""Light on surfaces over which a shadow moves, and on what moves itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import torch

from hybrid.base.compute_device import device_arrays
from hybrid.preparation.lighting import light_over_time
from pathtrace.dataset.capture import capture
from pathtrace.dataset.captured_frames import render_frame
from pathtrace.dataset.frame_set import CaptureSettings, FrameSet
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.tracer import Tracer
from splat.io.forest_file import load_forest, save_forest
from splat.lod.forest_renderer import ForestRenderer
from splat.model.dynamic_light import NodeLight, SurfaceLight
from splat.model.forest import Forest, forest_of
from splat.model.trees import build_forest
from splat.training.initialization import seed_at
from splat.training.training_view import TrainingView
from tests import small
from tests.extremes import extreme

# The card is over the middle of the wall at t = 0.5.
TIMES = (0.1, 0.5, 0.9)


@contextmanager
def silent(title: str):
    yield lambda done, total, step="": None


def described() -> dict[str, Any]:
    """A wall, and a card beside the view, between the wall and a lamp."""

    def square(z: float, side: float, grey: float, y: float = 0.0) -> dict[str, Any]:
        facing = mi.ScalarTransform4f().translate([0.2, y, z]).rotate([0, 1, 0], 180)
        reflectance = {"type": "rgb", "value": grey}
        return {
            "type": "rectangle",
            "to_world": facing.scale(side),
            "bsdf": {"type": "diffuse", "reflectance": reflectance},
        }

    return {
        "type": "scene",
        "sensor": small.sensor(48, 48),
        "wall": square(2, 4, 0.7),
        "card": square(0.5, 0.3, 0.4, y=1.7),
        "lamp": {"type": "point", "position": [0.2, 3.4, -1.0], "intensity": {"type": "rgb", "value": 60.0}},
    }


@pytest.fixture(scope="module")
def scene(backend, tmp_path_factory) -> Scene:
    """The card goes past."""
    file = tmp_path_factory.mktemp("scene") / "any.motion.json"
    track = {"keyframes": [{"t": 0, "translate": [-4, 0, 0]}, {"t": 1, "translate": [4, 0, 0]}]}
    file.write_text(json.dumps({"shapes": {"card": track}}))
    return load_scene(described(), motion=file)


def captured(scene: Scene, folder: Path) -> FrameSet:
    settings = CaptureSettings(views=12, held_out=0, width=48, height=48, spp=8)
    return capture(scene, folder, settings, lambda done, total: None)


def light_of(scene: Scene, frames: FrameSet) -> SurfaceLight:
    scene.set_time(0.0)
    cache = fill_cache(scene, [scene.camera], points=1 << 12)
    scene.set_time(0.7)
    found = light_over_time(scene, cache, frames, 2000, 0, silent)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def frames(scene, tmp_path_factory) -> FrameSet:
    return captured(scene, tmp_path_factory.mktemp("frames"))


@pytest.fixture(scope="module")
def light(scene, frames) -> SurfaceLight:
    return light_of(scene, frames)


def light_with(folder: Path, change: Callable[[dict[str, Any]], None]) -> SurfaceLight:
    """Of the scene with the card and some change to its description."""
    file, scene = folder / "any.motion.json", described()
    track = {"keyframes": [{"t": 0, "translate": [-4, 0, 0]}, {"t": 1, "translate": [4, 0, 0]}]}
    file.write_text(json.dumps({"shapes": {"card": track}}))
    change(scene)
    loaded = load_scene(scene, motion=file)
    return light_of(loaded, captured(loaded, folder / "frames"))


def forest_in(light: SurfaceLight | None, scene: Scene) -> Forest:
    """Seeds at time 0, when no shadow is in view."""
    scene.set_time(0.0)
    frame = render_frame(Tracer(scene), scene.camera, 16, 0)
    view = TrainingView(scene.camera, frame.radiance, frame.unfolded, frame.normal)
    lit = None if light is None else NodeLight(light)
    seeds = seed_at(view, np.arange(48 * 48), 0.6, 0, None, lit)
    return forest_of(build_forest(seeds, 0.05, 2), scene.camera.fy, scene.name, scene.hash, light=light)


@pytest.fixture(scope="module")
def lit(scene, light) -> Forest:
    return forest_in(light, scene)


def error(scene: Scene, forest: Forest, time: float) -> float:
    scene.set_time(time)
    truth = render_frame(Tracer(scene), scene.camera, 32, 1).radiance
    renderer = ForestRenderer(device_arrays(), forest)
    renderer.set_time(time)
    image = renderer.render_layer(scene.camera, len(forest.counts)).numpy()
    inner = np.s_[4:-4, 4:-4]
    return float(np.mean((image[inner] - truth[inner]) ** 2))


def test_a_shadow_passes_over_the_splats(scene, lit):
    assert lit.light is not None
    assert 0.02 < len(lit.light.nodes) / len(lit.nodes) < 0.9
    before, found = ([error(scene, f, time) for time in TIMES] for f in (forest_in(None, scene), lit))
    assert found[1] < 0.4 * before[1]
    for side in (0, 2):
        assert found[side] < 1.1 * before[side] + 1e-6


def test_points_without_a_shadow_have_no_course(light):
    changes = light.changes.numpy()
    factors = light.factors.float().numpy()
    assert 0.02 < changes.mean() < 0.9
    assert np.ptp(factors, axis=0).mean(axis=0)[~changes].max() < 0.081
    assert np.ptp(factors, axis=0).mean(axis=0)[changes].min() > 0.079
    assert factors[..., changes].max() < 1.3
    assert factors[..., changes].min() < 0.5


def test_the_same_seed_gives_the_same_light(scene, frames, light):
    again = light_of(scene, frames)
    for name in SurfaceLight.__dataclass_fields__:
        torch.testing.assert_close(getattr(again, name), getattr(light, name), rtol=0, atol=0)


def test_light_comes_back_from_a_file(lit, tmp_path):
    save_forest(tmp_path / "f", lit)
    back = load_forest(tmp_path / "f")
    assert back.light is not None
    assert lit.light is not None
    for name, tensor in lit.light.tensors().items():
        torch.testing.assert_close(back.light.tensors()[name], tensor, rtol=0, atol=0)
    assert back.digest() == lit.digest()


def test_what_moves_has_the_light_of_where_it_is(backend, tmp_path):
    """A board that moves away from a lamp above it, at the same angle."""
    file = tmp_path / "any.motion.json"
    file.write_text(
        json.dumps({"shapes": {"wall": {"keyframes": [{"t": 0}, {"t": 1, "translate": [0, 0, 2]}]}}})
    )
    described_wall = described()
    del described_wall["card"]
    described_wall["lamp"]["position"] = [0.0, 0.0, -3.0]
    moving = load_scene(described_wall, motion=file)
    light = light_of(moving, captured(moving, tmp_path / "frames"))
    assert set(light.instance.tolist()) == {0}
    assert bool(light.changes.all())
    times = np.linspace(0, 1, len(light.factors))
    way = light.means.double().numpy()[:, None] + np.stack([0 * times, 0 * times, 2 * times])[:, :, None]
    way[2] += 3
    exact = way[2] / np.linalg.norm(way, axis=0) ** 3
    factors = light.factors.float().numpy()
    np.testing.assert_allclose(
        factors / factors[0], np.tile((exact / exact[0])[:, None], (1, 3, 1)), rtol=0.03
    )


@extreme("light that changes, without light", given="a lamp of intensity 0", expected="no factor but one")
def test_where_there_is_no_light_none_changes(backend, tmp_path, got):
    found = light_with(tmp_path, lambda scene: scene["lamp"]["intensity"].update(value=0.0))
    assert not bool(found.changes.any())
    assert got(float((found.factors - 1).abs().max()), ".0g") == 0


@extreme(
    "light that is a million times as bright", given="a lamp of intensity 6e7", expected="the same factors"
)
def test_factors_do_not_depend_on_the_lamps_brightness(backend, tmp_path, light, got):
    found = light_with(tmp_path, lambda scene: scene["lamp"]["intensity"].update(value=6e7))
    least, most = (float(part.min()) for part in (found.factors, light.factors))
    assert got(least, ".3f") == pytest.approx(most, abs=0.02)
    assert abs(float(found.changes.float().mean()) - float(light.changes.float().mean())) < 0.05


@extreme(
    "light on a mover that is never seen",
    given="a board behind the camera",
    expected="light on the wall alone",
)
def test_a_mover_that_nobody_sees_has_no_light(light, got):
    assert got(len(light.instance.unique())) == 1
    assert int(light.instance.max()) == -1
