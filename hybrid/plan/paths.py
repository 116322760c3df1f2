"""How long paths have to be, and from where on roulette may end them."""

from __future__ import annotations

from collections.abc import Sequence

from compose.camera.camera import Camera
from hybrid.plan.decision import Decision
from pathtrace.scene.scene import RUSSIAN_ROULETTE_DEPTH, Scene
from pathtrace.trace.depths import MOST_SEGMENTS, UNBOUNDED, depth_shares, path_costs

# Share of the mean radiance that may be lost to a bound on the length of paths.
MOST_BIAS = 0.005
# Paths per view that are measured, for radiance and for costs.
_PATHS, _COSTED = 1 << 15, 1 << 13
# Depths of roulette that are tried beside the usual one, and the least gain for another one, or for a bound.
_TRIED, _LEAST_GAIN = (3, 8), 1.1
DEPTH, ROULETTE = "path depth", "roulette depth"


def path_decisions(scene: Scene, cameras: Sequence[Camera], seed: int) -> list[Decision]:
    """The depth of paths, and that of roulette.

    Args:
        scene: the scene.
        cameras: views, that decide together.
        seed: of the paths.
    """
    depth = _depth_decision(scene, cameras, seed)
    return [depth, _roulette(scene, cameras, int(depth.value), seed)]


def _depth_decision(scene: Scene, cameras: Sequence[Camera], seed: int) -> Decision:
    """A bound if it saves something: a small share of all radiance may be all of what is seen in glass."""
    shares = depth_shares(scene, cameras, _PATHS, seed)
    needed = max(shares.depth_for(MOST_BIAS), 2)
    bounded, unbounded = (
        path_costs(scene, cameras, _COSTED, (most, RUSSIAN_ROULETTE_DEPTH), seed).segments
        for most in (needed, UNBOUNDED)
    )
    pays = unbounded >= _LEAST_GAIN * bounded
    evidence = {
        "share_by_depth": [round(float(share), 6) for share in shares.shares[:needed]],
        "needed": needed,
        "beyond": shares.beyond(needed),
        "beyond_error": shares.error_beyond(needed),
        "beyond_own_depth": shares.beyond(scene.own_depth),
        "most": MOST_BIAS,
        "is_bounded": needed < MOST_SEGMENTS,
        "segments": bounded,
        "segments_unbounded": unbounded,
    }
    depth, gain = (needed, unbounded / bounded) if pays else (UNBOUNDED, 1.0)
    return Decision(DEPTH, depth, UNBOUNDED, evidence, gain, "segments per path")


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
