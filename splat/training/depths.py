"""Distances that Gaussians themselves show, for frames of which nobody knows any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from compose.base.arrays import Arrays
from splat.model.gaussians import SH_DC, Gaussians
from splat.model.perceptual import perceptual_from_radiance
from splat.raster.differentiable import render_differentiable
from splat.raster.projection import PIXEL_FILTER
from splat.training.views import TrainingView

# Coverage of a pixel above which its Gaussians tell where its surface is.
_COVERED = 0.5


def measured(arrays: Arrays, gaussians: Gaussians, view: TrainingView) -> TrainingView:
    """A view whose guessed distances are those that Gaussians show, where they cover a pixel.

    Distances are rasterized as if they were colours: the mean over a pixel's Gaussians, by their weights.

    Args:
        arrays: the backend's array types.
        gaussians: as they are at the view's time, in its coordinates.
        view: whose distances are guesses; where nothing is, nothing changes.
    """
    position = torch.from_numpy(view.camera.position).float()
    distance = (gaussians.means - position[:, None]).norm(dim=0)
    here = torch.nonzero(distance < view.sky / 2)[:, 0]
    if not len(here):
        return view
    unit = distance[here].median().clamp(min=1e-6)
    values = torch.stack([distance[here] / unit, torch.ones(len(here)), torch.zeros(len(here))])
    sh = ((perceptual_from_radiance(values) - 0.5) / SH_DC)[None]
    shown = replace(gaussians.select(here), sh=sh, directional=None)
    with torch.no_grad():
        image = render_differentiable(arrays, shown, view.camera, PIXEL_FILTER).numpy()
    total, coverage = image[..., 0] * float(unit), image[..., 1]
    known = (coverage > _COVERED) & (view.distance < view.sky)
    found = np.where(known, total / np.maximum(coverage, _COVERED), view.distance)
    return replace(view, distance=found.astype(np.float32))
