"""Optimizer steps from random starts, far beyond what training meets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera, camera_from_pose, look_at
from splat.model.gaussians import Gaussians, sh_count
from splat.raster.differentiable import render_differentiable
from splat.training.gaussian_optimizer import GaussianOptimizer
from splat.training.loss import FrameTarget

_SIDE = 24
_STEPS_PER_START = 25


@dataclass(frozen=True)
class Step:
    """One step: whether it changed anything, and whether all parameters and moments are finite after it."""

    taken: bool
    finite: bool


def random_steps(arrays: Arrays, count: int, seed: int) -> Iterator[Step]:
    """Steps from random starts.

    Scales, sizes of colours, distances of the camera and learning rates are random over many decades; targets
    are black, constant, noise, or noise of radiance up to a million.
    """
    for start in range(-(-count // _STEPS_PER_START)):
        rng = np.random.default_rng([seed, start])
        optimizer = GaussianOptimizer(_gaussians(rng), float(10 ** rng.uniform(-5, 1)))
        camera, target = _camera(rng), FrameTarget(arrays, torch.from_numpy(_radiance(rng)))
        for number in range(_STEPS_PER_START):
            chosen = optimizer.chosen(torch.arange(len(optimizer.gaussians)))
            loss, _ = target.loss(render_differentiable(arrays, chosen, camera))
            taken = optimizer.step(loss, number / _STEPS_PER_START)
            yield Step(taken, all(bool(torch.isfinite(t).all()) for t in optimizer.state().values()))


def _gaussians(rng: np.random.Generator) -> Gaussians:
    n, degree = int(rng.integers(1, 60)), int(rng.integers(4))
    # Some sets are alike in size, some are not; some lie in one point.
    log_scales = np.log(10) * (rng.uniform(-6, 3) + rng.uniform(0, 2) * rng.normal(size=(3, n)))
    values = (
        rng.normal(size=(3, n)) * 10 ** rng.uniform(-6, 3),
        log_scales,
        rng.normal(size=(4, n)) * 10 ** rng.uniform(-3, 3),
        rng.normal(size=n) * 10 ** rng.uniform(-1, 1.5),
        rng.normal(size=(sh_count(degree), 3, n)) * 10 ** rng.uniform(-3, 3),
    )
    return Gaussians(*(torch.from_numpy(value.astype(np.float32)) for value in values))


def _camera(rng: np.random.Generator) -> Camera:
    position = rng.normal(size=3) * 10 ** rng.uniform(-3, 5)
    focal = _SIDE * 10 ** rng.uniform(-1, 3)
    pose = look_at(position, np.zeros(3), rng.normal(size=3))
    return camera_from_pose(pose, _SIDE, _SIDE, focal, focal, _SIDE / 2, _SIDE / 2)


def _radiance(rng: np.random.Generator) -> np.ndarray:
    noise = rng.uniform(size=(_SIDE, _SIDE, 3))
    kinds = (noise * 0, noise * 0 + 0.5, noise, noise * 10 ** rng.uniform(0, 6), noise * 0 + 1e6)
    return kinds[rng.integers(len(kinds))].astype(np.float32)
