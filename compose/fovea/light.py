"""Light records: sums over samples, as they are stored and added up.

A record is eight floats: the number of samples, three sums of their radiance, three of its squares, and 0.
Kernels load it at once.
"""

from __future__ import annotations

import numpy as np

from compose.fovea.samples import Floats, Samples

# Floats of a record.
LIGHT = 8
# Makes 0 of 0 / 0.
_NO_SAMPLES = np.float32(1e-6)


def light_of(samples: Samples) -> Floats:
    """(D, 8) records of samples."""
    light = np.zeros((len(samples.count), LIGHT), dtype=np.float32)
    light[:, 0] = samples.count
    np.multiply(samples.radiance, samples.count[:, None], out=light[:, 1:4])
    np.multiply(samples.squares, samples.count[:, None], out=light[:, 4:7])
    return light


def means(light: Floats) -> tuple[Floats, Floats, Floats]:
    """(D,) counts and (D, 3) means of radiance and of its squares from records (D, 8)."""
    divisor = np.maximum(light[:, :1], _NO_SAMPLES)
    return light[:, 0], light[:, 1:4] / divisor, light[:, 4:7] / divisor
