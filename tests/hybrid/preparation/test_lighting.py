"""Factors for nodes over which a shadow moves."""

from __future__ import annotations

import json
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import torch

from hybrid.preparation.lighting import with_light_course
from hybrid.runtime.device import device_arrays
from pathtrace.dataset.rendering import render_frame
from pathtrace.fill.fill import fill_cache
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.tracer import Tracer
from splat.io.forest_file import load_forest, save_forest
from splat.lod.renderer import ForestRenderer
from splat.model.building import build_forest
from splat.model.forest import Forest, forest_of
from splat.training.initialization import seed_at
from splat.training.views import TrainingView
from tests import small

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


@pytest.fixture(scope="module")
def forest(scene) -> Forest:
    """Seeds at time 0, when no shadow is in view."""
    scene.set_time(0.0)
    frame = render_frame(Tracer(scene), scene.camera, 16, 0)
    view = TrainingView(scene.camera, frame.radiance, frame.unfolded, frame.normal)
    layers = build_forest(seed_at(view, np.arange(48 * 48), 0.6, 0), 0.05, 2)
    return forest_of(layers, scene.camera.fy, scene.name, scene.hash)


@pytest.fixture(scope="module")
def lit(scene, forest) -> Forest:
    scene.set_time(0.0)
    cache = fill_cache(scene, [scene.camera], points=1 << 12)
    return with_light_course(forest, scene, cache, [scene.camera], 0, silent)


def error(scene: Scene, forest: Forest, time: float) -> float:
    scene.set_time(time)
    truth = render_frame(Tracer(scene), scene.camera, 32, 1).radiance
    renderer = ForestRenderer(device_arrays(), forest)
    renderer.set_time(time)
    image = renderer.render_layer(scene.camera, len(forest.counts)).image()
    inner = np.s_[4:-4, 4:-4]
    return float(np.mean((image[inner] - truth[inner]) ** 2))


def test_a_shadow_passes_over_the_splats(scene, forest, lit):
    assert lit.light is not None
    assert 0.02 < len(lit.light.nodes) / len(lit.nodes) < 0.9
    before, found = ([error(scene, f, time) for time in TIMES] for f in (forest, lit))
    assert found[1] < 0.4 * before[1]
    for side in (0, 2):
        assert found[side] < 1.1 * before[side] + 1e-6


def test_nodes_without_a_shadow_have_no_factor(lit, forest):
    assert lit.light is not None
    factors = lit.light.factors
    assert float(factors.max()) < 1.3
    assert float(factors.min()) < 0.5
    assert bool((np.ptp(factors.numpy(), axis=0) > 0.08).all())
    assert lit.nodes is forest.nodes


def test_light_comes_back_from_a_file(lit, tmp_path):
    save_forest(tmp_path / "f", lit)
    back = load_forest(tmp_path / "f")
    assert back.light is not None
    assert lit.light is not None
    for name, tensor in lit.light.tensors().items():
        torch.testing.assert_close(back.light.tensors()[name], tensor, rtol=0, atol=0)
    assert back.digest() == lit.digest()
    assert replace(lit, light=None).digest() != lit.digest()


def test_where_no_light_changes_the_forest_stays_as_it_is(scene, forest):
    """A card that is as far away at all times."""
    scene.set_time(0.0)
    cache = fill_cache(scene, [scene.camera], points=1 << 10)
    away = [scene.camera.resized(8, 8)]
    far = replace(forest, nodes=replace(forest.nodes, gaussians=replace(forest.nodes.gaussians)))
    far.nodes.gaussians.means = far.nodes.gaussians.means + 50
    assert with_light_course(far, scene, cache, away, 0, silent) is far


def test_nodes_on_what_moves_have_no_factor(backend, tmp_path):
    """Of a wall that hardly moves, under a shadow; its nodes have no label, like those of a sheet."""
    file = tmp_path / "any.motion.json"
    across = {"keyframes": [{"t": 0, "translate": [-4, 0, 0]}, {"t": 1, "translate": [4, 0, 0]}]}
    nearly = {"keyframes": [{"t": 0}, {"t": 1, "translate": [0, 0, 0.001]}]}
    file.write_text(json.dumps({"shapes": {"card": across, "wall": nearly}}))
    moving = load_scene(described(), motion=file)
    assert moving.moving is not None
    assert len(moving.moving.shapes) == 2
    frame = render_frame(Tracer(moving), moving.camera, 4, 0)
    view = TrainingView(moving.camera, frame.radiance, frame.unfolded, frame.normal)
    own = forest_of([seed_at(view, np.arange(0, 2304, 5), 0.6, 0)], moving.camera.fy, "", "")
    cache = fill_cache(moving, [moving.camera], points=1 << 10)
    assert with_light_course(own, moving, cache, [moving.camera], 0, silent) is own
