"""Renders captured frames: traced, denoised, with geometry."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Camera
from pathtrace.dataset.exr import CapturedFrame
from pathtrace.trace.film import frame_positions
from pathtrace.trace.image import TracedImage, trace_image
from pathtrace.trace.tracer import Tracer

# Between the seeds of the parts of one frame.
_PART_SEED_STEP = 1_000_033


def render_frame(tracer: Tracer, camera: Camera, spp: int, seed: int) -> CapturedFrame:
    """A denoised frame with `spp` samples per pixel and its geometry; same seed, same frame."""
    return render_with_estimates(tracer, camera, spp, seed, ())[0]


def render_with_estimates(
    tracer: Tracer, camera: Camera, spp: int, seed: int, estimate_spp: tuple[int, ...]
) -> tuple[CapturedFrame, list[TracedImage]]:
    """A denoised frame, and noisy estimates of it from disjoint parts of its samples.

    Args:
        tracer: traces the scene.
        camera: the view.
        spp: samples per pixel of the frame.
        seed: same seed, same frame and estimates.
        estimate_spp: samples per pixel of each estimate; their sum must be less than `spp`.

    Returns:
        The frame, and one estimate per entry of `estimate_spp`.
    """
    positions = frame_positions(camera)
    hits = tracer.hits(camera, positions)
    shape = (camera.height, camera.width)
    counts = (*estimate_spp, spp - sum(estimate_spp))
    parts = [
        trace_image(tracer, camera, positions, camera.width, count, seed + number * _PART_SEED_STEP)
        for number, count in enumerate(counts)
    ]
    mean = _weighted_mean(parts, counts)
    cosine = (camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]).astype(np.float32)
    frame = CapturedFrame(
        mean.denoised(),
        mean.albedo,
        mean.normal,
        (hits.distance * cosine).reshape(shape),
        hits.unfolded.reshape(shape),
        hits.shape.reshape(shape),
    )
    return frame, parts[:-1]


def _weighted_mean(parts: list[TracedImage], counts: tuple[int, ...]) -> TracedImage:
    """Mean of images, weighted by their sample counts."""
    weights = np.array(counts, dtype=np.float32) / sum(counts)
    mean = lambda name: sum(  # noqa: E731
        weight * getattr(part, name) for weight, part in zip(weights, parts, strict=True)
    )
    return TracedImage(mean("radiance"), mean("albedo"), mean("normal"))
