"""What bounding indirect light takes from frames."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr

from compose.camera.camera import Camera
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer

# Side in pixels of the frames that tell, and their samples per pixel.
_SIDE, _SPP = 64, 64


def clamping_bias(bounded: Tracer, unbounded: Tracer, cameras: Sequence[Camera], seed: int) -> float:
    """Share of the mean radiance that a bound on indirect light removes, 0 to 1, over some views.

    Both trace the same paths, so that the difference is the bound's alone; rare bright paths make it vary
    with the seed all the same.

    Args:
        bounded, unbounded: tracers of one scene with and without the bound.
        cameras: the views.
        seed: same seed, same result.
    """
    total = [0.0, 0.0]
    for number, camera in enumerate(cameras):
        small = camera.resized(_SIDE, _SIDE)
        for index, tracer in enumerate((bounded, unbounded)):
            radiance = tracer.trace(small, frame_positions(small), _SPP, seed + number).radiance
            total[index] += sum(float(dr.sum(channel)[0]) for channel in radiance)
    return 1 - total[0] / total[1] if total[1] else 0.0
