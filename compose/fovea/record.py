"""Records: sums over a pixel's samples, as they are stored, reprojected and added up.

A record is sixteen floats: the number of samples, three sums of their radiance, three of its squares; the
number of sample positions whose auxiliary features are known, three sums of their albedo, three of their
normals; and two zeros. Kernels load it at once. Here, N records are a list of sixteen Floats (N,).

Sums of squares that are beyond float32 are inf. Sums of radiance that are, which takes several samples near
the largest float, count as that.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from compose.fovea.samples import Samples

# Floats of a record, and which of them are what.
RECORD = 16
COUNT, RADIANCE, SQUARES = 0, slice(1, 4), slice(4, 7)
POSITIONS, ALBEDO, NORMAL = 7, slice(8, 11), slice(11, 14)
_LIGHT, _FEATURES = range(7), range(7, 14)
# Makes 0 of 0 / 0.
_NOTHING = 1e-6
_LARGEST = float(np.finfo(np.float32).max)


def with_light(records: list[Any], samples: Samples) -> list[Any]:
    """Records (D,) with the light of samples added."""
    light = [1, *samples.radiance, *samples.squares]
    return [dr.fma(samples.count, more, own) for own, more in zip(records, light, strict=False)] + records[7:]


def with_features(records: list[Any], samples: Samples, positions: Any) -> list[Any]:
    """Records (D,) with auxiliary features added, means over a number of sample positions."""
    features = zip(records[7:], [1, *samples.albedo, *samples.normal], strict=False)
    return records[:7] + [own + more * positions for own, more in features] + records[14:]


def means(records: list[Any]) -> tuple[Any, list[Any], list[Any], list[Any], list[Any]]:
    """Counts (D,), and three Floats (D,) each: means of radiance, squares, albedo and normal."""
    by_count, by_positions = (1 / dr.maximum(records[of], _NOTHING) for of in (COUNT, POSITIONS))
    radiance = [dr.minimum(total, _LARGEST) * by_count for total in records[RADIANCE]]
    squares = [total * by_count for total in records[SQUARES]]
    albedo, normal = ([total * by_positions for total in records[part]] for part in (ALBEDO, NORMAL))
    return records[COUNT], radiance, squares, albedo, normal


def limited(records: list[Any], most: float) -> list[Any]:
    """Records (D,) that stand for more samples or sample positions than `most` scaled down to it."""
    scales = {
        part: dr.minimum(most / dr.maximum(records[n], _NOTHING), 1)
        for n, part in ((COUNT, _LIGHT), (POSITIONS, _FEATURES))
    }
    found = list(records)
    for part, scale in scales.items():
        for number in part:
            found[number] = records[number] * scale
    return found
