"""How much of the frame a disc covers while the gaze moves, and how far the gaze may move."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Camera
from compose.fovea.region import Foveation
from hybrid.measure.timing import REACH, gaze_path

# The gaze moves at least this far, in fractions of the frame's side.
_LEAST_REACH = 0.02


def reach_for(radius: float, camera: Camera) -> tuple[float, float]:
    """How far the gaze may move from the centre so that a disc covers about as much as it does there.

    Along an axis on which the disc fits into the frame, the gaze moves until the disc touches the edge. Along
    an axis on which it does not fit, moving loses more on one side than it gains on the other; there the gaze
    moves so little that less than half a percent of the covered pixels is lost.

    Args:
        radius: in percent of the height.
        camera: of the frame.

    Returns:
        Fractions of the frame's width and height, for `gaze_path`.
    """
    pixels = radius / 100 * camera.height
    across, down = (
        max(_LEAST_REACH, min(most, 0.5 - pixels / side))
        for most, side in zip(REACH, (camera.width, camera.height), strict=True)
    )
    return across, down


def covered(radius: float, camera: Camera, count: int, reach: tuple[float, float]) -> float:
    """Mean fraction of the frame that a disc covers along a gaze path.

    Args:
        radius: in percent of the height.
        camera: of the frame.
        count, reach: of the path.
    """
    width, height = camera.width, camera.height
    along = (Foveation(gaze, radius, radius).region(width, height) for gaze in gaze_path(count, reach))
    return float(np.mean([region.count for region in along]) / (width * height))
