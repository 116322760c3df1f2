"""A quick look at a scene: small frames of views of a region."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera, View
from compose.image.colour import Image
from pathtrace.region import ViewingRegion
from pathtrace.region.neighbourhood import view_time
from pathtrace.scene.scene import Scene
from pathtrace.scene.triangles import Surfaces
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.traced_images import TracedImage, trace_frame
from pathtrace.trace.tracer import Tracer
from splat.training.training_view import TrainingView

# Views, the side of their frames in pixels, and samples per pixel.
VIEWS, _SIDE, _SPP = 6, 96, 8
# Views of which frames as large as those to train on are traced, their side, and samples of each half.
_LARGER, _LARGER_SIDE, HALF_SPP = 3, 256, 4
# Views nearer together than this, over the distance to what they see, are one point.
_ONE_POINT = 0.002


@dataclass(frozen=True)
class Look:
    """What V views of a scene show, at times spread over those of one that moves."""

    views: list[View]
    radiance: list[Image]  # V of (H, W, 3), noisy
    gloss: list[NDArray[np.int64]]  # V of (H, W), class of gloss of each pixel (compose.base.traced_samples)
    reflected: list[NDArray[np.bool_]]  # V of (H, W), where a flat mirror or a pane shows something else
    # Of some views, larger: two independent halves of HALF_SPP samples per pixel each.
    halves: list[tuple[TracedImage, TracedImage]]
    larger: list[tuple[Camera, NDArray[np.float32]]]  # camera, and (H, W) distance along each pixel's ray
    parallax: float  # largest distance between two views, over the median distance to what they see

    @cached_property
    def denoised(self) -> list[Image]:
        """(H, W, 3) radiance of the larger frames, denoised from all of their samples."""
        return [one.mixed(other, 0.5).denoised() for one, other in self.halves]

    @cached_property
    def shown(self) -> list[TrainingView]:
        """The larger frames, denoised, as training has them."""
        frames = zip(self.larger, self.denoised, self.halves, strict=True)
        return [
            TrainingView(camera, radiance, distance, one.mixed(other, 0.5).normal)
            for (camera, distance), radiance, (one, other) in frames
        ]

    @property
    def is_one_point(self) -> bool:
        """Whether everything is seen from one direction only."""
        return self.parallax < _ONE_POINT


def look_at_scene(
    scene: Scene,
    surfaces: Surfaces,
    region: ViewingRegion,
    seed: int,
    progress: Callable[[int], None] = lambda done: None,
) -> Look:
    """Looks at a scene and its surfaces from a region; afterwards, one that moves shows its first time.

    `progress` is called with the number of views that have been looked from, out of VIEWS. UserError if there
    is no free space in the region.
    """
    cameras = region.views(VIEWS, _SIDE, _SIDE, seed)
    views = [View(camera, view_time(scene, number)) for number, camera in enumerate(cameras)]
    tracer = Tracer(scene)
    radiance, gloss, reflected, halves, larger_views = [], [], [], [], []
    for number, view in enumerate(views):
        progress(number)
        scene.show(view.time)
        positions = frame_positions(view.camera)
        traced = tracer.trace(view.camera, positions, _SPP, seed + number, features=True)
        assert traced.features is not None
        shape = (view.camera.height, view.camera.width)
        radiance.append(interleaved(traced.radiance).reshape(*shape, 3))
        gloss.append(traced.features.gloss.numpy().astype(np.int64).reshape(shape))
        reflected.append(tracer.hits(view.camera, positions).reflected.reshape(shape))
        if number < _LARGER:
            larger = view.camera.resized(_LARGER_SIDE, _LARGER_SIDE)
            halves.append(traced_halves(tracer, larger, seed + number))
            distance = tracer.hits(larger, frame_positions(larger)).unfolded
            larger_views.append((larger, distance.reshape(larger.height, larger.width)))
    scene.show(0.0)
    places = np.stack([camera.position for camera in cameras])
    apart = np.linalg.norm(places[:, None] - places, axis=-1).max()
    away = np.median([surfaces.median_distance(camera) for camera in cameras])
    parallax = float(apart / away) if np.isfinite(away) else 0.0
    return Look(views, radiance, gloss, reflected, halves, larger_views, parallax)


def traced_halves(tracer: Tracer, camera: Camera, seed: int) -> tuple[TracedImage, TracedImage]:
    """Two independent halves of the samples of a frame."""
    one, other = np.random.SeedSequence(seed).generate_state(2)
    return trace_frame(tracer, camera, HALF_SPP, int(one)), trace_frame(tracer, camera, HALF_SPP, int(other))
