"""How much of the frame a disc covers while the gaze moves, and how far the gaze may go without a loss."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Camera
from compose.fovea.region import Foveation
from hybrid.measure.timing import REACH, gaze_path

# So far the gaze goes at least: it must move.
_LEAST_REACH = 0.02


def reach_for(radius: float, camera: Camera) -> tuple[float, float]:
    """How far the gaze may go from the middle so that a disc covers as much as it does there.

    Along an axis on which the disc fits into the frame, up to where it touches the edge. Along one on which
    it does not, a step loses more on one side than it gains on the other; there the gaze moves so little that
    the loss stays below half a percent of what is covered.

    Args:
        radius: in percent of the height.
        camera: of the frame.

    Returns:
        Fractions of the frame's width and height, as `gaze_path` takes them.
    """
    pixels = radius / 100 * camera.height
    across, down = (
        max(_LEAST_REACH, min(most, 0.5 - pixels / side))
        for most, side in zip(REACH, (camera.width, camera.height), strict=True)
    )
    return across, down


def covered(radius: float, camera: Camera, count: int, reach: tuple[float, float]) -> float:
    """Mean share of the frame that a disc covers along a gaze path.

    Args:
        radius: in percent of the height.
        camera: of the frame.
        count, reach: of the path.
    """
    width, height = camera.width, camera.height
    regions_along = (
        Foveation(gaze, radius, radius).region(width, height) for gaze in gaze_path(count, reach)
    )
    return float(np.mean([len(region.pixels) for region in regions_along]) / (width * height))
