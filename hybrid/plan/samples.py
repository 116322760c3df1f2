"""How many samples frames need, and whether they are worth denoising."""

from __future__ import annotations

import numpy as np

from compose.image.colour import srgb_from_radiance
from hybrid.plan.decision import Decision
from hybrid.plan.look import HALF_SPP, Look
from pathtrace.dataset.frame_error import frame_error, mean_frame_error

DENOISED, RAW = "denoised", "raw"
SAMPLES, DENOISING = "samples", "denoising"
# Squared errors count as this at least: 120 dB.
_LEAST_ERROR = 1e-12
# Samples by which denoising must stand in for more, at least.
_LEAST_GAIN = 1.2
# Samples per pixel of training frames where nothing is known, and the range of those that are planned.
FIXED_SAMPLES, _RANGE = 32, (16, 128)
# Frames of this PSNR in dB limit no forest noticeably: the best ones of 40,000 Gaussians have about as much.
# With frames of 34 dB, `veach-bidir` lost 0.4 dB.
CONVERGED_DB = 35.0
# What doubling the samples of a frame gains in dB.
_GAIN_DB = {DENOISED: 1.5, RAW: 3.0}


def sample_decisions(look: Look) -> list[Decision]:
    """Samples per pixel of training frames, and whether to denoise frames of few samples.

    Both errors are stated from two independent halves: that of a raw half from their difference, that of the
    frame denoised from both as of pathtrace.dataset.frame_error. Squared noise falls with the samples, which
    tells how many raw frames take to be as close to the truth.
    """
    apart = [
        srgb_from_radiance(one.radiance) - srgb_from_radiance(other.radiance) for one, other in look.halves
    ]
    raw = float(np.mean(np.square(apart))) / 2
    frames = zip(look.halves, look.denoised, strict=True)
    denoised = mean_frame_error([frame_error(*halves, denoised) for halves, denoised in frames]).mse
    gain = max(raw / 2, _LEAST_ERROR) / max(denoised, _LEAST_ERROR)
    kind = DENOISED if gain >= _LEAST_GAIN else RAW
    evidence = {
        "raw_spp": HALF_SPP,
        "raw_db": _db(raw),
        "denoised_spp": 2 * HALF_SPP,
        "denoised_db": _db(denoised),
    }
    return [
        _samples(kind, _db(denoised if kind == DENOISED else raw / 2)),
        Decision(
            DENOISING, kind, RAW, evidence, gain if kind == DENOISED else 1.0, "samples for equal error"
        ),
    ]


def _samples(kind: str, found_db: float) -> Decision:
    """As many samples as frames need that have some PSNR with 2 * HALF_SPP."""
    doublings = np.ceil((CONVERGED_DB - found_db) / _GAIN_DB[kind])
    samples = int(np.clip(2 * HALF_SPP * 2.0 ** np.clip(doublings, -8, 8), *_RANGE))
    evidence = {
        "spp": 2 * HALF_SPP,
        "db": found_db,
        "wanted_db": CONVERGED_DB,
        "db_per_doubling": _GAIN_DB[kind],
    }
    return Decision(SAMPLES, samples, FIXED_SAMPLES, evidence, FIXED_SAMPLES / samples, "samples to trace")


def _db(squared: float) -> float:
    return float(-10 * np.log10(max(squared, _LEAST_ERROR)))
