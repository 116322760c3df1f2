"""Saliency of views: when it is computed anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.camera import camera as turning
from compose.camera.camera import Camera
from compose.eye.detail import CELL
from hybrid.render.periphery import ViewSaliency
from splat.lod.forest_renderer import ForestRenderer

WIDTH, HEIGHT = 96, 80


@pytest.fixture
def saliency(arrays, forest) -> ViewSaliency:
    return ViewSaliency(ForestRenderer(arrays, forest), forest)


@pytest.fixture(scope="module")
def camera(scene) -> Camera:
    return scene.camera.resized(WIDTH, HEIGHT)


def turned(camera: Camera, pixels: float) -> Camera:
    """A camera that sees the middle of a view a number of pixels aside."""
    pose = camera.camera_to_world.copy()
    pose[:3, :3] = turning.turned(pose[:3, :3], float(np.degrees(np.arctan(pixels / camera.fx))), 0)
    return replace(camera, world_to_camera=np.linalg.inv(pose))


def test_it_is_computed_once_per_camera(saliency, camera):
    found = saliency.of(camera)
    assert found.shape == (HEIGHT // CELL + 1, WIDTH // CELL + 1)
    assert 0 <= found.min() < found.max() <= 1
    assert saliency.of(replace(camera)) is found
    other = saliency.of(replace(camera, fx=camera.fx * 0.5))
    assert not np.array_equal(other, found)


def test_nearly_the_same_view_keeps_it_until_it_has_moved_by_a_cell(saliency, camera):
    found = saliency.of(camera)
    assert saliency.of(turned(camera, 0.5 * CELL), nearly=True) is found
    # Small steps add up.
    assert saliency.of(turned(camera, 0.7 * CELL), nearly=True) is found
    moved = saliency.of(turned(camera, 1.3 * CELL), nearly=True)
    assert moved is not found
    assert saliency.of(turned(camera, 1.6 * CELL), nearly=True) is moved


@pytest.mark.parametrize("step", [0.5 * CELL, -0.5 * CELL])
def test_only_those_who_ask_for_it_get_that_of_nearly_the_same_view(saliency, camera, step):
    found = saliency.of(camera)
    exact = saliency.of(turned(camera, step))
    assert exact is not found
    assert not np.array_equal(exact, found)


def test_another_frame_size_or_a_view_of_nothing_is_never_nearly_the_same(saliency, camera):
    found = saliency.of(camera)
    larger = saliency.of(camera.resized(2 * WIDTH, 2 * HEIGHT), nearly=True)
    assert larger.shape != found.shape
    behind = camera.world_to_camera.copy()
    behind[2, 3] -= 1e3
    away = replace(camera, world_to_camera=behind)
    nothing = saliency.of(away, nearly=True)
    assert not nothing.any()
    assert saliency.of(turned(away, 0.1), nearly=True) is not nothing
