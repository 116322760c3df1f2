"""One row of a sweep: what is rendered, and what it is compared with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from compose.camera.camera import Camera
from hybrid.frame.periphery import Viewing


@dataclass(frozen=True)
class Setting:
    """A hybrid frame with all that may vary.

    Attributes:
        varied: the quantities of this sweep, by name.
        camera: the view.
        fov_a, fov_b: radii in percent of the height.
        spp: samples per pixel in the disc.
        fovea: raw, denoised or fused.
        viewing: display, acuity model and layers.
        paper: FPC's own ratios for this row, by the names of ours; empty where there are none.
        over_one_spp: whether the full frame at one sample per pixel is what to compare with as well.
    """

    varied: dict[str, Any]
    camera: Camera
    fov_a: float
    fov_b: float
    spp: int
    fovea: str
    viewing: Viewing
    paper: dict[str, float] = field(default_factory=dict)
    over_one_spp: bool = False


def varied(row: dict[str, Any]) -> dict[str, Any]:
    """Of a sweep's row, the quantities that vary: what stands before the times."""
    names = list(row)
    return {name: row[name] for name in names[: names.index("ms")]}
