"""Whether frames are worth denoising, and how many samples that saves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compose.camera.view import View
from compose.image.colour import srgb_from_radiance
from hybrid.plan.decision import Decision
from pathtrace.dataset.frame_error import frame_error, mean_frame_error
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.image import trace_image
from pathtrace.trace.tracer import Tracer

DENOISED, RAW = "denoised", "raw"
# Samples per pixel of each of two halves, and views that are traced.
_HALF, _VIEWS = 4, 3
# Squared errors count as this at least: 120 dB.
_LEAST_ERROR = 1e-12
# Samples by which denoising must stand in for more, at least.
_LEAST_GAIN = 1.2


def denoising_decision(scene: Scene, views: Sequence[View], seed: int) -> Decision:
    """Whether to denoise frames of few samples.

    Both errors are stated from two independent halves: that of a raw half from their difference, that of the
    frame denoised from both as of pathtrace.dataset.frame_error. Squared noise falls with the samples, which
    tells how many raw frames take to be as close to the truth.

    Args:
        scene: the scene; afterwards, one that moves shows the time of the last view.
        views: of which some are traced.
        seed: of their samples.
    """
    tracer, errors, noise = Tracer(scene), [], []
    for number, view in enumerate(views[:_VIEWS]):
        scene.show(view.time)
        positions = frame_positions(view.camera)
        one, other = (
            trace_image(tracer, view.camera, positions, view.camera.width, _HALF, seed + 2 * number + half)
            for half in (0, 1)
        )
        errors.append(frame_error(one, other))
        apart = srgb_from_radiance(one.radiance) - srgb_from_radiance(other.radiance)
        noise.append(float(np.mean(np.square(apart))) / 2)
    raw, denoised = float(np.mean(noise)), mean_frame_error(errors).mse
    gain = max(raw / 2, _LEAST_ERROR) / max(denoised, _LEAST_ERROR)
    evidence = {
        "raw_spp": _HALF,
        "raw_db": _db(raw),
        "denoised_spp": 2 * _HALF,
        "denoised_db": _db(denoised),
    }
    pays = gain >= _LEAST_GAIN
    return Decision(
        "denoising",
        DENOISED if pays else RAW,
        RAW,
        evidence,
        gain if pays else 1.0,
        "samples for equal error",
    )


def _db(squared: float) -> float:
    return float(-10 * np.log10(max(squared, _LEAST_ERROR)))
