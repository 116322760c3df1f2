"""A quick look at a scene: small frames of views around its own camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.camera.view import View
from compose.image.colour import Image
from pathtrace.dataset.views import choose_views
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer

# Views, the side of their frames in pixels, and samples per pixel.
_VIEWS, _SIDE, _SPP = 6, 96, 8


@dataclass(frozen=True)
class Look:
    """What V views of a scene show, at times spread over those of one that moves.

    Attributes:
        views: cameras and times.
        radiance: V of (H, W, 3), noisy.
        gloss: V of (H, W), class of gloss of what each pixel shows (compose.image.gloss).
        reflected: V of (H, W) bool, where a flat mirror or a pane shows something else.
    """

    views: list[View]
    radiance: list[Image]
    gloss: list[NDArray[np.int64]]
    reflected: list[NDArray[np.bool_]]

    @property
    def cameras(self) -> list[Camera]:
        """Of the views."""
        return [view.camera for view in self.views]


def look_at_scene(scene: Scene, seed: int) -> Look:
    """Looks at a scene; afterwards, one that moves shows its first time.

    Raises:
        UserError: the scene's own camera sees no surface, or there is no free space around it.
    """
    cameras = choose_views(scene, Surfaces(scene), _VIEWS, _SIDE, _SIDE, seed)
    views = [
        View(camera, time)
        for camera, time in zip([*cameras.fixed, *cameras.spread], cameras.times, strict=True)
    ]
    tracer = Tracer(scene)
    radiance, gloss, reflected = [], [], []
    for number, view in enumerate(views):
        scene.show(view.time)
        positions = frame_positions(view.camera)
        traced = tracer.trace(view.camera, positions, _SPP, seed + number, features=True)
        assert traced.features is not None
        shape = (view.camera.height, view.camera.width)
        radiance.append(interleaved(traced.radiance).reshape(*shape, 3))
        gloss.append(traced.features.gloss.numpy().astype(np.int64).reshape(shape))
        reflected.append(tracer.hits(view.camera, positions).reflected.reshape(shape))
    scene.show(0.0)
    return Look(views, radiance, gloss, reflected)
