"""How long frames would have to be traced until their noise no longer matters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hybrid.plan.samples import CONVERGED_DB

# What doubling the samples of a denoised frame gains at least and at most, in dB; it was 1.0 (caustics) to
# 2.2 on five scenes, and is 3 without a denoiser.
_LEAST_GAIN, _MOST_GAIN = 0.5, 3.0


@dataclass(frozen=True)
class Pass:
    """What a pass over the frames has brought.

    Attributes:
        samples: per pixel, mean over all frames so far.
        error_db: PSNR of the frames, as they state it.
        seconds: of tracing, over all passes so far.
    """

    samples: float
    error_db: float
    seconds: float


def converging_seconds(passes: Sequence[Pass]) -> float | None:
    """Seconds of tracing in all until the frames have CONVERGED_DB; None if they do, or nobody can tell.

    Each further doubling of the samples is taken to gain as much as those from the first pass to the last.
    """
    if len(passes) < 2 or passes[-1].error_db >= CONVERGED_DB:
        return None
    first, last = passes[0], passes[-1]
    if last.samples <= first.samples:
        return None
    gain = (last.error_db - first.error_db) / math.log2(last.samples / first.samples)
    doublings = (CONVERGED_DB - last.error_db) / min(max(gain, _LEAST_GAIN), _MOST_GAIN)
    return last.seconds * 2**doublings
