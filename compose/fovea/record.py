"""Records: sums over a pixel's samples, as they are stored, reprojected and added up.

A record is sixteen floats: the number of samples, three sums of their radiance, three of its squares; the
number of sample positions whose auxiliary features are known, three sums of their albedo, three of their
normals; and two zeros. Kernels load it at once.

Sums of squares that are beyond float32 are inf. Sums of radiance that are, which takes several samples near
the largest float, count as that.
"""

from __future__ import annotations

import numpy as np

from compose.fovea.samples import Floats, Samples

# Floats of a record, and its columns.
RECORD = 16
COUNT, RADIANCE, SQUARES = 0, slice(1, 4), slice(4, 7)
POSITIONS, ALBEDO, NORMAL = 7, slice(8, 11), slice(11, 14)
_LIGHT, _FEATURES = slice(0, 7), slice(7, 14)
# Makes 0 of 0 / 0.
_NOTHING = np.float32(1e-6)
_LARGEST = np.finfo(np.float32).max


def add_light(records: Floats, samples: Samples) -> None:
    """Adds the light of samples to records (D, 16)."""
    count = samples.count[:, None]
    records[:, COUNT] += samples.count
    with np.errstate(over="ignore"):
        records[:, RADIANCE] += samples.radiance * count
        records[:, SQUARES] += samples.squares * count


def add_features(records: Floats, samples: Samples, positions: int) -> None:
    """Adds auxiliary features, means over a number of sample positions, to records (D, 16)."""
    records[:, POSITIONS] += positions
    records[:, ALBEDO] += samples.albedo * positions
    records[:, NORMAL] += samples.normal * positions


def means(records: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """(D,) counts, and (D, 3) means of radiance, squares, albedo and normal from records (D, 16)."""
    by_count = 1 / np.maximum(records[:, COUNT, None], _NOTHING)
    by_positions = 1 / np.maximum(records[:, POSITIONS, None], _NOTHING)
    light = np.minimum(records[:, RADIANCE], _LARGEST) * by_count, records[:, SQUARES] * by_count
    features = (records[:, part] * by_positions for part in (ALBEDO, NORMAL))
    return records[:, COUNT], *light, *features


def limit(records: Floats, most: float) -> None:
    """Scales records (D, 16) that stand for more samples or sample positions than `most` down to it."""
    for number, part in ((COUNT, _LIGHT), (POSITIONS, _FEATURES)):
        records[:, part] *= np.minimum(most / np.maximum(records[:, number, None], _NOTHING), 1)
