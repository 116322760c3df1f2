"""What a training can choose, by the names in commands and files: model of motion, labels, precision."""

from __future__ import annotations

from enum import Enum


class FieldKind(str, Enum):
    """Fields that deform Gaussians, by their names in files."""

    D_GS = "d-gs"
    HEX_PLANE = "4dgs"


class Labels(str, Enum):
    """What tells which pixels show something that moves, by their names in commands."""

    # Exact masks of instances, which captured frames have.
    MASKS = "masks"
    # Frames of other times.
    FLOW = "flow"


class MotionModel(str, Enum):
    """Models of motion, by their names in commands."""

    # Courses that frames know.
    KNOWN = "known"
    # A field that deforms every Gaussian, or only those that frames show to move.
    D_GS = "d-gs"
    D_GS_OF_DYNAMIC = "d-gs-dynamic"
    HEX_PLANE = "4dgs"

    @property
    def field(self) -> FieldKind | None:
        """The kind of a learned motion; None if it is known."""
        return None if self is MotionModel.KNOWN else FieldKind(self.value.removesuffix("-dynamic"))


class Precision(str, Enum):
    """Numbers of Gaussians in a forest file."""

    COMPACT = "compact"  # rounded to what the eye does not miss, about a fifth of the size (splat.io.compact)
    FLOAT32 = "float32"  # exactly as they were trained
