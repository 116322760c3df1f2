"""Renders captured frames: traced, denoised, with geometry."""

from __future__ import annotations

from collections.abc import Container

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from pathtrace.dataset.exr import CapturedFrame
from pathtrace.trace.film import frame_positions
from pathtrace.trace.image import TracedImage, trace_image
from pathtrace.trace.tracer import Tracer

# Between the seeds of the parts of one view: halves of its frame, then estimates.
_PART_SEED_STEP = 1_000_033
_HALVES = 2


def render_frame(tracer: Tracer, camera: Camera, spp: int, seed: int) -> CapturedFrame:
    """A denoised frame with `spp` samples per pixel and its geometry; same seed, same frame."""
    traced = trace_image(tracer, camera, frame_positions(camera), camera.width, spp, seed)
    return _frame(tracer, camera, traced)


def render_with_halves(
    tracer: Tracer, camera: Camera, spp: int, seed: int
) -> tuple[CapturedFrame, tuple[Image, Image]]:
    """A denoised frame, and the two independent halves of its samples.

    The halves tell how noisy the frame was before denoising, without bias (Lehtinen et al. 2018).

    Args:
        tracer: traces the scene.
        camera: the view.
        spp: samples per pixel of the frame, at least 2.
        seed: same seed, same frame and halves.

    Returns:
        The frame, and (H, W, 3) linear radiance of each half.
    """
    positions, counts = frame_positions(camera), (spp - spp // 2, spp // 2)
    one, other = (
        trace_image(tracer, camera, positions, camera.width, count, seed + number * _PART_SEED_STEP)
        for number, count in enumerate(counts)
    )
    share = np.float32(counts[1] / spp)
    mean = lambda name: (1 - share) * getattr(one, name) + share * getattr(other, name)  # noqa: E731
    traced = TracedImage(mean("radiance"), mean("albedo"), mean("normal"))
    return _frame(tracer, camera, traced), (one.radiance, other.radiance)


def render_estimates(
    tracer: Tracer, camera: Camera, counts: tuple[int, ...], seed: int, wanted: Container[int] | None = None
) -> list[TracedImage]:
    """Noisy estimates of a view, independent of its frame's samples.

    Args:
        tracer: traces the scene.
        camera: the view.
        counts: samples per pixel of each estimate.
        seed: same seed and counts, same estimates.
        wanted: those of the counts that are traced, if not all are.
    """
    return [
        trace_image(
            tracer, camera, frame_positions(camera), camera.width, count, seed + number * _PART_SEED_STEP
        )
        for number, count in enumerate(counts, start=_HALVES)
        if wanted is None or count in wanted
    ]


def geometry_of(tracer: Tracer, camera: Camera) -> tuple[Image, Image, NDArray[np.int32]]:
    """What a view shows: depth, unfolded distance and shape, (H, W) each, as of `CapturedFrame`."""
    hits = tracer.hits(camera, frame_positions(camera))
    shape = (camera.height, camera.width)
    cosine = (camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]).astype(np.float32)
    return (
        (hits.distance * cosine).reshape(shape),
        hits.unfolded.reshape(shape),
        hits.shape.reshape(shape),
    )


def _frame(tracer: Tracer, camera: Camera, traced: TracedImage) -> CapturedFrame:
    """The denoised frame of a traced image, with its geometry."""
    shading = traced.denoised(), traced.albedo, traced.normal
    return CapturedFrame(*shading, *geometry_of(tracer, camera))
