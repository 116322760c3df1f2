"""Forests that need no training."""

from __future__ import annotations

import numpy as np
import torch

from hybrid.preparation.forest_training import motion_of
from hybrid.render.forest_attachments import attach_views
from pathtrace.dataset.captured_frames import render_frame
from pathtrace.scene.scene import Scene
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest, forest_of
from splat.model.gaussians import Gaussians
from splat.model.trees import build_forest, static_layer
from splat.training.initialization import seed_at
from splat.training.training_view import TrainingView
from tests import small


def rough_forest(scene: Scene, degree: int = 0) -> Forest:
    """Three layers of untrained Gaussians: a rough picture of the scene, enough to blend with.

    They claim to know more than any frame shows, so that nothing is filled.
    """
    frame = render_frame(Tracer(scene), scene.camera, 4, 0)
    view = TrainingView(scene.camera, frame.radiance, frame.unfolded, frame.normal)
    pixels = scene.camera.width * scene.camera.height
    chosen = small.rng().choice(pixels, min(500, pixels), replace=False)
    # Half transparent, and with gaps: as in the middle of a training.
    seeds = seed_at(view, chosen, 0.6 * float(np.sqrt(pixels / 500)), degree)
    layers = build_forest(seeds, 0.05, 3)
    forest = forest_of(layers, scene.camera.fy, scene.name, scene.hash)
    return attach_views(forest, [scene.camera.resized(4 * scene.camera.width, scene.camera.height)])


def white_dot(point: tuple[float, float, float], focal: float = 50.0, opacity_logit: float = 8.0) -> Forest:
    """One small white Gaussian, nearly opaque, that fits any scene."""
    dot = Gaussians(
        torch.tensor(point, dtype=torch.float32)[:, None],
        torch.full((3, 1), float(np.log(0.03))),
        torch.tensor([[1.0], [0], [0], [0]]),
        torch.tensor([opacity_logit]),
        torch.full((1, 3, 1), 1.7),
    )
    return forest_of([static_layer(dot)], focal, "", "")


def moving_forest(scene: Scene) -> Forest:
    """Seeds at every pixel of the scene's own view at time 0, on what moves as well."""
    assert scene.moving is not None
    scene.set_time(0.0)
    camera = scene.camera.resized(64, 64)
    frame = render_frame(Tracer(scene), camera, 16, 0)
    courses = scene.moving.courses()
    motion = motion_of(courses)
    instance = np.where(frame.shape == courses[0].shape, 0, -1).astype(np.int32)
    view = TrainingView(camera, frame.radiance, frame.unfolded, frame.normal, instance=instance)
    seeds = seed_at(view, np.arange(camera.width * camera.height), 0.6, 0, motion)
    return forest_of([seeds], camera.fy, scene.name, scene.hash, motion=motion)
