"""How the light on the surfaces of a scene that moves changes over time, as the path tracer finds it.

A forest is trained on frames of all times. Where a shadow passes, a node would learn a mean of bright and
dark; knowing how bright it is in each frame, it learns what it looks like in usual light.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from hybrid.base.progress import Bars
from hybrid.preparation.forest_training import motion_of
from hybrid.preparation.training_views import training_view
from pathtrace.cache.cells import Points
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.dataset.frame_set import FrameSet
from pathtrace.fill.gather import irradiance_over_time
from pathtrace.scene.scene import Scene
from splat.model.dynamic_light import SurfaceLight
from splat.model.gaussians import Gaussians, concatenated
from splat.model.motion import NodeMotion, turned
from splat.training.initialization import seed_at
from splat.training.training_view import TrainingView

# Times at which irradiance is found: so many in a second of the scene, within limits.
_PER_SECOND, _LEAST_TIMES, _MOST_TIMES = 30, 33, 513
# Change of the factor that counts.
_LEAST_CHANGE = 0.08
# Largest factor: where there is no light most of the time, ratios mean nothing.
_LARGEST = 8.0
# Views whose pixels are points, at most, and the largest share of points on what moves.
_VIEWS, _MOVING = 48, 0.25
# Points per Gaussian of the finest layer, and most numbers that are kept of all of them.
_POINTS, _MOST_NUMBERS = 1.5, 1 << 26
# Irradiance that counts as none, as a share of the mean.
_DARK = 1e-3
# Of the curve on which training compares radiance, about.
_GAMMA = 2.2
# How far points are lifted off what moves, as a share of its size: it is not exactly where its pieces are.
_LIFT = 0.01


def light_over_time(
    scene: Scene, cache: IrradianceCache, frames: FrameSet, gaussians: int, seed: int, bars: Bars
) -> SurfaceLight | None:
    """Light at points that the training frames of a moving scene show; None if they show no surface.

    The scene shows its last time afterwards. `cache` is of its irradiance at time 0; the number of points
    follows that of the Gaussians in the finest layer.
    """
    motion = motion_of(frames.courses)
    entries = frames.training[:: -(-len(frames.training) // _VIEWS)]
    views = [training_view(entry, frames.courses) for entry in entries]
    rng = np.random.default_rng([seed, 5])
    seconds = 0.0 if scene.moving is None else scene.moving.motion.seconds
    times = np.linspace(0, 1, min(max(round(seconds * _PER_SECOND) + 1, _LEAST_TIMES), _MOST_TIMES)).tolist()
    count = min(int(gaussians * _POINTS), _MOST_NUMBERS // (3 * len(times)))
    seeds, instance = _seeds(views, count, motion, rng)
    if not len(instance):
        return None
    lifts = torch.zeros(len(instance))
    for number in instance[instance >= 0].unique():
        own = seeds.means[:, instance == number]
        lifts[instance == number] = _LIFT * torch.linalg.vector_norm(own.amax(dim=1) - own.amin(dim=1))

    def at(time: float) -> Points:
        """Where the seeds are at a time, lifted off their surface."""
        shown = seeds if motion is None else motion.shown(seeds, instance, time)
        normals = _normals(shown)
        return Points((shown.means + lifts * normals).T.numpy(), normals.T.numpy())

    moving = np.flatnonzero(instance.numpy() >= 0)
    with bars("light over time") as bar:
        irradiance = irradiance_over_time(scene, cache, at, moving, times, seed, bar)
    # Irradiance (T, 3, N) over that which training has seen most of, up to a limit.
    perceived = (irradiance ** (1 / _GAMMA)).mean(axis=0) ** _GAMMA
    usual = (np.median(irradiance, axis=0) + perceived) / 2
    least = max(_DARK * float(usual.mean()), 1e-12)
    factors = np.minimum((irradiance + least) / (usual + least), np.float32(_LARGEST))
    changes = np.ptp(factors, axis=0).mean(axis=0) > _LEAST_CHANGE
    kept = (torch.from_numpy(part) for part in (factors.astype(np.float16), changes))
    return SurfaceLight(seeds.means, _normals(seeds), instance, *kept)


def _seeds(
    views: Sequence[TrainingView], count: int, motion: NodeMotion | None, rng: np.random.Generator
) -> tuple[Gaussians, torch.Tensor]:
    """About `count` seeds at rest at pixels that show surfaces without a mirror; and their instances."""
    parts = []
    for view in views:
        plain = np.flatnonzero(view.normal.reshape(-1, 3).any(axis=1))
        moves = view.instances(plain) >= 0
        for pixels, share in ((plain[~moves], 1 - _MOVING), (plain[moves], _MOVING)):
            chosen = rng.choice(pixels, min(len(pixels), int(share * count / len(views))), replace=False)
            parts.append(seed_at(view, chosen, 1.0, 0, motion))
    return concatenated([part.gaussians for part in parts]), torch.cat([part.semantic for part in parts])


def _normals(seeds: Gaussians) -> torch.Tensor:
    return turned(seeds.rotations, torch.tensor([[0.0], [0.0], [1.0]]).expand(3, len(seeds)))
