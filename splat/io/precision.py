"""How exactly a forest is stored."""

from __future__ import annotations

from enum import Enum


class Precision(str, Enum):
    """Numbers of Gaussians in a forest file.

    Attributes:
        COMPACT: rounded to what the eye does not miss, about a fifth of the size (splat.io.compact).
        FLOAT32: exactly as they were trained.
    """

    COMPACT = "compact"
    FLOAT32 = "float32"
