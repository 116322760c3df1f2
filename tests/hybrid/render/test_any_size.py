"""Frames of scenes of any size and place, while the viewer moves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.dataset.captured_frames import render_frame
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest, forest_of
from splat.model.trees import build_forest
from splat.training.initialization import seed_from_views
from splat.training.training_view import TrainingView, pixel_footprint, place_of
from splat.training.training_view import placed as placed_view
from tests import small
from tests.extremes import extreme
from tests.placed import placed

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def forest_in_its_place(scene: Scene) -> Forest:
    """Untrained Gaussians of a scene, in the coordinates in which training would put them."""
    frame = render_frame(Tracer(scene), scene.camera, 4, 0)
    view = TrainingView(scene.camera, frame.radiance, frame.unfolded, frame.normal)
    place = place_of([view])
    view = placed_view(view, place)
    seeds = seed_from_views([view], 500, 0, small.rng())
    layers = build_forest(seeds, pixel_footprint([view]), 3)
    return forest_of(layers, scene.camera.fy, scene.name, scene.hash, place)


def walk(scale: float, offset: float) -> list[np.ndarray]:
    """Three frames with a history: two of one view, one from a step to the side."""
    scene = load_scene(placed(small.corner(), scale, offset))
    renderer = LiveRenderer(scene, forest_in_its_place(scene))
    camera = scene.camera.resized(48, 48)
    moved = camera.world_to_camera.copy()
    moved[0, 3] -= 0.02 * scale / scene.place.unit
    frames = []
    for seed, view in enumerate((camera, camera, replace(camera, world_to_camera=moved))):
        settings = FrameSettings(fov_a=60, fov_b=50, spp=4, fovea="raw", camera=view)
        frames.append(np.array(renderer.frame(settings, seed).composite))
    return frames


@cache
def ordinary() -> list[np.ndarray]:
    return walk(1.0, 0.0)


@pytest.mark.parametrize(
    ("scale", "offset"),
    [
        pytest.param(
            s, o, marks=extreme(f"frames {n}", given="three frames of a walk", expected="over 35 dB")
        )
        for s, o, n in [
            (1e-4, 0.0, "at a scale of 1e-4"),
            (1e6, 0.0, "at a scale of 1e6"),
            (1.0, 1e6, "1e6 from the origin"),
        ]
    ],
)
def test_frames_look_the_same_in_any_size_and_place(scale, offset, got):
    for frame, expected in zip(walk(scale, offset), ordinary(), strict=True):
        assert np.isfinite(frame).all()
        difference = float(np.mean((np.clip(frame, 0, 1) - np.clip(expected, 0, 1)) ** 2))
        assert got(-10 * np.log10(max(difference, 1e-12)), ".0f") > 35
