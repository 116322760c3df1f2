"""Places Gaussians on the surfaces that training frames show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splat.model.dynamic_light import NodeLight
from splat.model.gaussians import Gaussians, perceptual_from_radiance
from splat.model.layer import Layer, concatenated_layers, static_layer
from splat.model.motion import Dynamics
from splat.training.sky import discs, opacity_logit, whole_sky
from splat.training.training_view import TrainingView

# A seed is a flat disc on its surface, this much thinner than wide.
_FLATNESS = 0.2
_INITIAL_OPACITY = 0.5
# Of the first seeds, which have to hide what lies behind the surface: a forest of half transparent ones is
# dark, and takes hundreds of steps to get out of it.
_COVERING_OPACITY = 0.9
# Share of all pixels up to which what hits nothing may be edges of surfaces, with nothing behind them.
_LEAST_SKY = 1e-3
# Pixels of a view, about, that tell in which directions the sky is seen, and as many for surfaces.
_DIRECTIONS = 1000
# Standard deviation of a seed, as a share of the distance to its neighbours.
_COVERING = 0.6
_NEIGHBOURS = 4
# A seed may be this much narrower or wider than if all were evenly spread over one view.
_NARROWEST, _WIDEST = 0.3, 8.0


def seed_from_views(
    views: list[TrainingView],
    count: int,
    degree: int,
    rng: np.random.Generator,
    motion: Dynamics | None = None,
    light: NodeLight | None = None,
) -> Layer:
    """Seeds at `count` random pixels of all views, wide enough to cover the surfaces together, and at rest.

    Pixels that show no surface give no seed; if one does, there is at least one seed. Where views show the
    sky, there are further ones behind those, for all of it.
    """
    pixels = views[0].camera.width * views[0].camera.height
    # The views overlap, so that about `count` seeds cover what one of them sees.
    spacing = np.sqrt(pixels / count)
    shares = np.full(len(views), count // len(views))
    shares[: count % len(views)] += 1
    size = spacing * _COVERING
    seeded = lambda view, pixels: seed_at(view, pixels, size, degree, motion, light)  # noqa: E731
    parts = []
    for view, share in zip(views, shares, strict=True):
        total = view.distance.size
        parts.append(seeded(view, rng.choice(total, min(int(share), total), replace=False)))
    seeds = concatenated_layers(parts)
    seeds = replace(seeds, gaussians=_covering(seeds.gaussians))
    seeds = concatenated_layers([seeds, static_layer(_sky_around(views, degree))])
    if len(seeds):
        return seeds
    # Hardly any pixel shows a surface, and no random one did.
    view = max(views, key=lambda view: len(view.surface_pixels))
    surface = view.surface_pixels
    return seeded(view, rng.choice(surface, 1) if len(surface) else surface)


def _covering(seeds: Gaussians) -> Gaussians:
    """The seeds, widened or narrowed until they cover the surfaces, and nearly opaque.

    Views overlap by more or less, so that only the seeds themselves know how far apart they are.
    """
    if len(seeds) <= _NEIGHBOURS:
        return seeds
    means = seeds.means.numpy().T
    gaps, _ = cKDTree(means).query(means, k=_NEIGHBOURS + 1)
    gap = np.sqrt(np.mean(gaps[:, 1:] ** 2, axis=1))
    log_scales = seeds.log_scales.numpy()
    change = np.log(np.clip(_COVERING * gap / np.exp(log_scales[0]), _NARROWEST, _WIDEST))
    wide = torch.from_numpy((log_scales + change).astype(np.float32))
    opaque = torch.full_like(seeds.opacity_logits, opacity_logit(_COVERING_OPACITY))
    return replace(seeds, log_scales=wide, opacity_logits=opaque)


def _sky_around(views: list[TrainingView], degree: int) -> Gaussians:
    """Seeds of the sky in all directions; none if the views show hardly any."""
    sky, surface = ([_some_directions(view, wanted) for view in views] for wanted in (True, False))
    far = sum(len(view.sky_pixels) for view in views)
    if far <= _LEAST_SKY * sum(view.distance.size for view in views):
        return Gaussians.none(degree)
    rays, radiance = (np.concatenate(part) for part in zip(*sky, strict=True))
    return whole_sky(rays, radiance, np.concatenate([rays for rays, _ in surface]), degree)


def _some_directions(view: TrainingView, sky: bool) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Some directions (M, 3) in which a view shows the sky, or else a surface, and their radiance (M, 3)."""
    seen = view.sky_pixels if sky else np.setdiff1d(view.surface_pixels, view.sky_pixels)
    seen = seen[:: max(1, len(seen) // _DIRECTIONS)]
    return view.rays(seen), view.radiance.reshape(-1, 3)[seen].astype(np.float32)


def seed_at(
    view: TrainingView,
    pixels: NDArray[np.int64],
    size: float,
    degree: int,
    motion: Dynamics | None = None,
    light: NodeLight | None = None,
) -> Layer:
    """Seeds, without parents, at pixels of one view, labelled by the instances that these show.

    They are where they are at rest, and have the radiance that they show in usual light.

    Args:
        pixels: (M,) row-major indices; pixels that show no surface give no seed.
        size: standard deviation in pixels of that frame.
        degree: of the spherical harmonics, of which only the constant one is set.
    """
    distance = view.distance.ravel()[pixels]
    pixels = pixels[np.isfinite(distance) & (distance > 0)]
    deviation = size * view.pixel_sizes(pixels)
    scales = np.stack([deviation, deviation, deviation * _FLATNESS])
    radiance = torch.from_numpy(view.radiance.reshape(-1, 3)[pixels].T.astype(np.float32))
    colour = perceptual_from_radiance(radiance.clamp(min=0))
    normals = view.normal.reshape(-1, 3)[pixels].astype(np.float64)
    seeds = discs(view.points(pixels), np.log(scales).T, normals, colour, _INITIAL_OPACITY, degree)
    found = static_layer(seeds)
    if motion is not None:
        instance = torch.from_numpy(view.instances(pixels))
        rest = motion.at_rest(seeds, instance, view.time)
        found = replace(static_layer(rest), semantic=instance, dynamic=instance >= 0)
    return found if light is None else light.in_usual_light(found, seeds, view.camera, view.time)
