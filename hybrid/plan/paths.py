"""How long paths have to be, and from where on roulette may end them."""

from __future__ import annotations

from collections.abc import Sequence

from compose.camera.camera import Camera
from hybrid.plan.decision import Decision
from pathtrace.scene.scene import RUSSIAN_ROULETTE_DEPTH, Scene
from pathtrace.trace.depths import MOST_SEGMENTS, UNBOUNDED, DepthShares, depth_shares, path_costs

# Share of the mean radiance that may be lost to a bound on the length of paths.
MOST_BIAS = 0.005
# Paths per view that are measured, for radiance and for costs.
_PATHS, _COSTED = 1 << 15, 1 << 13
# Depths of roulette that are tried beside the usual one, and the least gain for another.
_TRIED, _LEAST_GAIN = (3, 8), 1.1
DEPTH, ROULETTE = "path depth", "roulette depth"


def path_decisions(scene: Scene, cameras: Sequence[Camera], seed: int) -> list[Decision]:
    """The depth of paths, and that of roulette.

    Args:
        scene: the scene.
        cameras: views, that decide together.
        seed: of the paths.
    """
    shares = depth_shares(scene, cameras, _PATHS, seed)
    depth = max(shares.depth_for(MOST_BIAS), 2)
    return [_depth_decision(scene, cameras, shares, depth, seed), _roulette(scene, cameras, depth, seed)]


def _depth_decision(
    scene: Scene, cameras: Sequence[Camera], shares: DepthShares, depth: int, seed: int
) -> Decision:
    bounded, unbounded = (
        path_costs(scene, cameras, _COSTED, (most, RUSSIAN_ROULETTE_DEPTH), seed).segments
        for most in (depth, UNBOUNDED)
    )
    evidence = {
        "share_by_depth": [round(float(share), 6) for share in shares.shares[:depth]],
        "beyond": shares.beyond(depth),
        "beyond_error": shares.error_beyond(depth),
        "beyond_own_depth": shares.beyond(scene.own_depth),
        "most": MOST_BIAS,
        "is_bounded": depth < MOST_SEGMENTS,
    }
    return Decision(DEPTH, depth, UNBOUNDED, evidence, unbounded / bounded, "segments per path")


def _roulette(scene: Scene, cameras: Sequence[Camera], depth: int, seed: int) -> Decision:
    """The least work for equal noise: segments times variance."""
    work = {}
    for roulette in (RUSSIAN_ROULETTE_DEPTH, *_TRIED):
        cost = path_costs(scene, cameras, _COSTED, (depth, roulette), seed)
        work[roulette] = cost.segments * cost.variance
    best = min(work, key=lambda roulette: work[roulette])
    if work[RUSSIAN_ROULETTE_DEPTH] < _LEAST_GAIN * work[best]:
        best = RUSSIAN_ROULETTE_DEPTH
    gain = work[RUSSIAN_ROULETTE_DEPTH] / work[best] if work[best] else 1.0
    evidence = {"work": {str(roulette): work[roulette] for roulette in sorted(work)}}
    return Decision(ROULETTE, best, RUSSIAN_ROULETTE_DEPTH, evidence, gain, "segments for equal noise")
