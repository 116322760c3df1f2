"""Places Gaussians on the surfaces that training frames show, and behind them where they show the sky."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import logit

from compose.camera.camera import sphere_directions
from splat.model.dynamic_light import NodeLight
from splat.model.gaussians import SH_DC, Gaussians, perceptual_from_radiance, sh_count
from splat.model.motion import Dynamics
from splat.model.points import Floats, Ints
from splat.model.trees import Layer, concatenated_layers, static_layer
from splat.training.clusters import HitTree
from splat.training.training_view import SKY_DISTANCE, TrainingView

# A seed is a flat disc on its surface, this much thinner than wide.
_FLATNESS = 0.2
_INITIAL_OPACITY = 0.5
# Of the first seeds: a forest of half transparent ones is dark, and takes hundreds of steps to get out of it.
_COVERING_OPACITY = 0.9
# Standard deviation of a seed, as a share of the distance to its neighbours.
_COVERING = 0.6
_NEIGHBOURS = 4
# Least standard deviation of a seed in pixels, and the greatest one as a multiple of the spacing.
_NARROWEST, _WIDEST = 0.3, 8.0
# Hits that are clustered, at most: four times as many take four times as long, for seeds that are no better.
_MOST_HITS = 500_000
# Share of all pixels up to which what hits nothing may be edges of surfaces, with nothing behind them.
_LEAST_SKY = 1e-3
# Pixels of a view, about, that tell in which directions the sky is seen, and as many for surfaces.
_SEEN_DIRECTIONS = 1000
# Directions of the whole sphere in which there is a Gaussian behind all others if they show the sky.
_SKY_DIRECTIONS = 2000
_SPACING = float(np.sqrt(4 * np.pi / _SKY_DIRECTIONS))  # radians
# Their distance: even those beside each other in a frame are sorted by depth, which falls with the angle.
_BEHIND = 1.25 * SKY_DISTANCE
# Standard deviation as a share of the spacing, and opacity: together they hide what is behind.
_SKY_COVERING, _SKY_OPACITY = 0.75, 0.95
# Seen directions whose mean colour each gets.
_ALIKE = 24
# Share of seen colours above which they are that of the sun, which shines from one direction only.
_SUN = 0.98


def seed_from_views(
    views: list[TrainingView],
    count: int,
    degree: int,
    rng: np.random.Generator,
    motion: Dynamics | None = None,
    light: NodeLight | None = None,
) -> Layer:
    """About `count` seeds, at most, at rest: one in each leaf of an octree over what views show (`clusters`).

    Together they are wide enough to cover the surfaces. Pixels that show no surface give no seed; if one
    does, there is at least one seed. Where views show the sky, there are further ones behind those, for all
    of it.
    """
    hits = hits_of(views, rng, motion, light)
    if not len(hits):
        return _with_degree(hits, degree)
    if any(view.guessed for view in views):
        # What is together at guessed distances need not be so.
        seeds = hits.select(torch.from_numpy(_some_of(np.arange(len(hits)), count, rng)))
    else:
        seeds = HitTree(hits).seeds(count, rng)
    seeds = _with_degree(seeds, degree)
    # Views overlap, so that about `count` seeds cover what one of them sees.
    spacing = np.sqrt(views[0].distance.size / count)
    seeds = replace(seeds, gaussians=_covering(seeds.gaussians, max(1.0, spacing)))
    return concatenated_layers([seeds, static_layer(_sky_around(views, degree))])


def hits_of(
    views: list[TrainingView],
    rng: np.random.Generator | None = None,
    motion: Dynamics | None = None,
    light: NodeLight | None = None,
) -> Layer:
    """Seeds one pixel wide at pixels that show a surface: all of them, or about as many as are worth it."""
    rng = rng or np.random.default_rng(0)
    chosen = [_some_of(view.surface_pixels, _MOST_HITS // len(views), rng) for view in views]
    seeds = [seed_at(view, pixels, 1.0, 0, motion, light) for view, pixels in zip(views, chosen, strict=True)]
    return concatenated_layers([static_layer(Gaussians.none(0)), *seeds])


def _some_of(pixels: Ints, most: int, rng: np.random.Generator) -> Ints:
    """At most so many of the pixels, in order; at random, since rows are as regular as textures."""
    return pixels if len(pixels) <= most else np.sort(rng.choice(pixels, most, replace=False))


def _with_degree(layer: Layer, degree: int) -> Layer:
    constant = layer.gaussians.sh
    further = constant.new_zeros(sh_count(degree) - 1, 3, len(layer))
    return replace(layer, gaussians=replace(layer.gaussians, sh=torch.cat([constant, further])))


def _covering(seeds: Gaussians, spacing: float) -> Gaussians:
    """Seeds a pixel wide, widened or narrowed until they cover the surfaces, and nearly opaque.

    Only the seeds themselves know how far apart they are; `spacing` is in pixels of one view, if all were
    in it.
    """
    if len(seeds) <= _NEIGHBOURS:
        return seeds
    means = seeds.means.numpy().T
    gaps, _ = cKDTree(means).query(means, k=_NEIGHBOURS + 1, workers=-1)
    gap = np.sqrt(np.mean(gaps[:, 1:] ** 2, axis=1))
    log_scales = seeds.log_scales.numpy()
    change = np.log(np.clip(_COVERING * gap / np.exp(log_scales[0]), _NARROWEST, _WIDEST * spacing))
    wide = torch.from_numpy((log_scales + change).astype(np.float32))
    opaque = torch.full_like(seeds.opacity_logits, logit(_COVERING_OPACITY))
    return replace(seeds, log_scales=wide, opacity_logits=opaque)


def seed_at(
    view: TrainingView,
    pixels: Ints,
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
    seeds = _discs(view.points(pixels), np.log(scales).T, normals, colour, _INITIAL_OPACITY, degree)
    found = static_layer(seeds)
    if motion is not None:
        instance = torch.from_numpy(view.instances(pixels))
        rest = motion.at_rest(seeds, instance, view.time)
        found = replace(static_layer(rest), semantic=instance, dynamic=instance >= 0)
    return found if light is None else light.in_usual_light(found, seeds, view.camera, view.time)


def _discs(
    means: Floats, log_scales: Floats, normals: Floats, colour: torch.Tensor, opacity: float, degree: int
) -> Gaussians:
    """N Gaussians that look alike from everywhere and are flat: their third axis lies along the normal.

    Means, log-scales and normals are (N, 3), the colour is perceptual radiance (3, N).
    """
    sh = torch.zeros(sh_count(degree), 3, len(means))
    sh[0] = (colour - 0.5) / SH_DC
    parts = means, log_scales, _rotation_to(normals)
    rows = [torch.from_numpy(np.ascontiguousarray(part.T, dtype=np.float32)) for part in parts]
    return Gaussians(*[*rows, torch.full((len(means),), logit(opacity)), sh])


def _rotation_to(normals: Floats) -> Floats:
    """Quaternions (M, 4) that turn the z axis into the normals (M, 3); identity for a zero normal."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), [0.0, 0.0, 1.0])
    # Half-way quaternion (1 + z.n, z x n); for n = -z any half turn about a horizontal axis works.
    quaternion = np.stack([1 + unit[:, 2], -unit[:, 1], unit[:, 0], np.zeros(len(unit))], axis=1)
    quaternion[unit[:, 2] < -1 + 1e-6] = [0.0, 1.0, 0.0, 0.0]
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def _sky_around(views: list[TrainingView], degree: int) -> Gaussians:
    far = sum(len(view.sky_pixels) for view in views)
    if far <= _LEAST_SKY * sum(view.distance.size for view in views):
        return Gaussians.none(degree)
    some = lambda seen: seen[:: max(1, len(seen) // _SEEN_DIRECTIONS)]  # noqa: E731
    sky = [some(view.sky_pixels) for view in views]
    rays = [view.rays(pixels) for view, pixels in zip(views, sky, strict=True)]
    radiance = [view.radiance.reshape(-1, 3)[pixels] for view, pixels in zip(views, sky, strict=True)]
    surface = [view.rays(some(np.setdiff1d(view.surface_pixels, view.sky_pixels))) for view in views]
    shown = np.concatenate(radiance).astype(np.float32)
    return whole_sky(np.concatenate(rays), shown, np.concatenate(surface), degree)


def whole_sky(sky: Floats, radiance: NDArray[np.float32], surface: Floats, degree: int) -> Gaussians:
    """Gaussians behind all others in every direction of the sky, in the mean colour of what is next to it.

    A direction that no frame shows belongs to the sky if the nearest one that is seen does. Frames show the
    sky in unit directions (M, 3), its linear radiance (M, 3) there, and surfaces in unit directions (N, 3).
    """
    directions = sphere_directions(_SKY_DIRECTIONS)
    distance, near = cKDTree(sky).query(directions, k=np.arange(1, min(_ALIKE, len(sky)) + 1))
    if len(surface):
        # What stands before the sky in one view may not do so in another.
        belongs = distance[:, 0] < cKDTree(surface).query(directions)[0] + _SPACING
        directions, near = directions[belongs], near[belongs]
    seen = perceptual_from_radiance(torch.from_numpy(radiance).clamp(min=0))
    seen = torch.minimum(seen, seen.quantile(_SUN, dim=0))
    colour = seen[torch.from_numpy(near)].mean(dim=1).T
    log_scales = np.log(_BEHIND * _SPACING * _SKY_COVERING * np.array([1, 1, _FLATNESS]))
    log_scales = np.broadcast_to(log_scales, directions.shape)
    return _discs(_BEHIND * directions, log_scales, directions, colour, _SKY_OPACITY, degree)
