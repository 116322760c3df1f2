"""Rotations of transforms that scale, shear or mirror as well."""

from __future__ import annotations

import numpy as np

from pathtrace.motion.course import Array


def nearest_rotations(linear: Array) -> Array:
    """(T, 3, 3) the rotations nearest to matrices (T, 3, 3); none is a mirror image (Kabsch 1976)."""
    left, _, right = np.linalg.svd(linear)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)
