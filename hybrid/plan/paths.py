"""How long paths have to be, and from where on roulette may end them."""

from __future__ import annotations

import time
from collections.abc import Sequence

import drjit as dr
import numpy as np

from compose.camera.camera import Camera
from hybrid.plan.decision import Decision
from pathtrace.scene.scene import Scene
from pathtrace.trace.depths import MOST_SEGMENTS, depth_shares
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import RUSSIAN_ROULETTE_DEPTH, Tracer

# Share of the mean radiance that may be lost to a bound on the length of paths.
MOST_BIAS = 0.005
# Paths per view that are measured.
_PATHS = 1 << 15
# Depths of roulette that are tried beside the usual one, the least gain for another, and how often each is
# timed, with how many samples per pixel.
_TRIED, _LEAST_GAIN, _ROUNDS, _SPP = (3, 8), 1.1, 3, 8
# Share of pixels with the largest variances that tell nothing: of fireflies, too few are seen.
_FIREFLIES = 0.01
UNBOUNDED = -1


def path_decisions(scene: Scene, cameras: Sequence[Camera], seed: int) -> list[Decision]:
    """The depth of paths, and that of roulette.

    Args:
        scene: the scene.
        cameras: views, that decide together.
        seed: of the paths.
    """
    shares = depth_shares(scene, cameras, _PATHS, seed)
    depth = max(shares.depth_for(MOST_BIAS), 2)
    tried = [(depth, RUSSIAN_ROULETTE_DEPTH), (UNBOUNDED, RUSSIAN_ROULETTE_DEPTH)]
    tried += [(depth, roulette) for roulette in _TRIED]
    cost = _costs(scene, cameras[0], tried, seed)
    bounded, unbounded = cost[:2]
    evidence = {
        "share_by_depth": [round(float(share), 6) for share in shares.shares[:depth]],
        "beyond": shares.beyond(depth),
        "beyond_error": shares.error_beyond(depth),
        "beyond_own_depth": shares.beyond(scene.max_depth),
        "most": MOST_BIAS,
        "is_bounded": depth < MOST_SEGMENTS,
    }
    # Work for equal noise: time times variance.
    work = {
        roulette: seconds * variance for (_, roulette), (seconds, variance) in zip(tried, cost, strict=True)
    }
    work[RUSSIAN_ROULETTE_DEPTH] = bounded[0] * bounded[1]
    best = min(work, key=lambda roulette: work[roulette])
    if work[RUSSIAN_ROULETTE_DEPTH] < _LEAST_GAIN * work[best]:
        best = RUSSIAN_ROULETTE_DEPTH
    gain = work[RUSSIAN_ROULETTE_DEPTH] / work[best] if work[best] else 1.0
    return [
        Decision("path depth", depth, UNBOUNDED, evidence, unbounded[0] / bounded[0], "time per path"),
        Decision(
            "roulette depth",
            best,
            RUSSIAN_ROULETTE_DEPTH,
            {"work": {str(roulette): work[roulette] for roulette in sorted(work)}},
            gain,
            "time for equal noise",
        ),
    ]


def _costs(
    scene: Scene, camera: Camera, tried: Sequence[tuple[int, int]], seed: int
) -> list[tuple[float, float]]:
    """Seconds per sample and pixel, the median of interleaved rounds, and variance of a sample, of depths."""
    tracers = [Tracer(scene, depth, roulette) for depth, roulette in tried]
    positions = frame_positions(camera)
    seconds: list[list[float]] = [[] for _ in tried]
    variances: list[list[float]] = [[] for _ in tried]
    # The first round compiles.
    for turn in range(_ROUNDS + 1):
        for number, tracer in enumerate(tracers):
            start = time.perf_counter()
            traced = tracer.trace(camera, positions, _SPP, seed + turn)
            dr.eval(traced.radiance, traced.squares)
            dr.sync_thread()
            if turn:
                seconds[number].append((time.perf_counter() - start) / (_SPP * positions.count))
            radiance, squares = (
                np.stack([channel.numpy() for channel in channels])
                for channels in (traced.radiance, traced.squares)
            )
            spread = np.sort(np.maximum(squares - radiance**2, 0).mean(axis=0))
            kept = spread[: max(1, int(len(spread) * (1 - _FIREFLIES)))]
            variances[number].append(float(kept.mean()))
    return [(float(np.median(s)), float(np.mean(v))) for s, v in zip(seconds, variances, strict=True)]
