"""Fits Gaussians to pictures of Gaussians, so that any view tells something, and no path is traced.

Other programs blend as 3D Gaussian splatting does. The same numbers look darker there at soft edges, and
wider by its larger filter: in `room` 31 dB from the forest's own picture. Once fitted it is 38 dB, and at
twice the resolution of the training 36.

Of a hierarchy, merged moments are a start; what a node should show also depends on what lies around it, and
on what of it fewer and larger Gaussians can show at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera, camera_from_pose, look_at, turned
from compose.camera.coordinate_systems import TYPICAL_DISTANCE
from compose.image.colour import SRGB_DARK_VALUE, SRGB_SLOPE, decibels
from splat.model.gaussians import SH_DC, Blending, Gaussians, concatenated, perceptual_from_radiance
from splat.model.hierarchy import USUAL_CONTRAST, CutTree, Hierarchy
from splat.model.points import Floats, rows_of
from splat.raster.cut import HierarchyCut
from splat.raster.differentiable import render_differentiable, visible
from splat.raster.projection import NEAR, PIXEL_FILTER
from splat.raster.tiles import TILE
from splat.training.gaussian_optimizer import GaussianOptimizer

# Least number of steps of a fit for display, and steps per view where there are many.
_STEPS, _PER_VIEW = 400, 4
# Side in pixels of the part of a view that a step looks at.
_SIDE = 256
# Standard deviation, in degrees, by which views are turned at random.
_TURN = 8.0
# Half of the views have the resolution of the training, the others up to so many octaves more.
_CLOSER = 1.5
# Positions move by a tenth of what they do in a training: Gaussians are where they belong.
_STILLNESS = 0.1
# Share of the steps, at the end, whose views tell how well others are shown.
_JUDGED = 0.1
# Number of views where none are known, and how far beyond the two Gaussians that they lie between.
_VIEWS, _BEYOND = 64, 0.25
# Cuts have this share of the leaves that a view shows, at least and at most, on a logarithmic scale.
_LEAST, _MOST = 1 / 40, 0.9
# Of as many steps as a fit has, this part measures contrasts before it, and the rest after it.
_MEASURED_BEFORE = 4
# Where nothing is seen of what a node hides, that counts as this part of what is usual.
_LEAST_SHOWN = 1e-4
# Of display-encoded pictures (H, W, 3) of a cut and of its leaves, (H, W).
Difference = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
# Level in pixels that no node is smaller than, from which cuts are made coarser.
_FINEST = 0.05


def fitted_for_display(
    arrays: Arrays,
    gaussians: Gaussians,
    focal: float,
    cameras: Sequence[Camera],
    seed: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Gaussians, float]:
    """Gaussians for the rules of 3D Gaussian splatting that look as those given, which are blended linearly.

    Args:
        gaussians: N, on the host.
        focal: vertical focal length in pixels of the frames that they were trained on.
        cameras: views of any size, in the coordinates of the Gaussians; at least one.
        seed: which views between these are looked at.
        progress: is told steps done, and all.

    Returns:
        The Gaussians, in the same order, and the PSNR in dB of display-encoded pictures of them to those of
        the ones given, in views that they were not fitted to yet.
    """
    own = gaussians.to(arrays.device)
    optimizer = GaussianOptimizer(gaussians, _STILLNESS * TYPICAL_DISTANCE / focal, arrays.device)
    steps, errors = max(_STEPS, _PER_VIEW * len(cameras)), []
    for step in range(steps):
        camera = _between(cameras, focal, np.random.default_rng([seed, step]))
        shown = visible(arrays, replace(optimizer.on_device, blending=Blending.DISPLAY), camera)
        if len(shown):
            with torch.no_grad():
                truth = _picture(arrays, own, camera, _low_pass(camera, focal))
            chosen = replace(optimizer.chosen(shown), blending=Blending.DISPLAY)
            image = _picture(arrays, chosen, camera, PIXEL_FILTER)
            # What is brighter than a display shows need not be as bright, but may.
            difference = torch.where(truth < 1, image, image.clamp(max=1)) - truth.clamp(max=1)
            optimizer.step(difference.abs().mean(), step / steps)
            if step >= (1 - _JUDGED) * steps:
                errors.append(float(difference.detach().clamp(max=1).square().mean()))
        progress(step + 1, steps)
    psnr = decibels(float(np.mean(errors))) if errors else np.inf
    return replace(optimizer.gaussians, blending=Blending.DISPLAY), psnr


@dataclass(frozen=True)
class CutViews:
    """Parts of views in which cuts are compared with their leaves.

    Attributes:
        leaves: N Gaussians, on the host.
        focal, cameras: as for `fitted_for_display`.
    """

    arrays: Arrays
    leaves: Gaussians
    focal: float
    cameras: Sequence[Camera]

    def cut_at_random(self, cut: HierarchyCut, seeds: list[int]) -> tuple[Camera, float, torch.Tensor]:
        """A camera, its low-pass, and the indices (K,) of a cut's nodes, in ascending order."""
        rng = np.random.default_rng(seeds)
        camera = _between(self.cameras, self.focal, rng)
        return camera, _low_pass(camera, self.focal), _cut_at_random(cut, camera, rng)

    def picture(self, gaussians: Gaussians, camera: Camera, low_pass: float) -> torch.Tensor:
        """(H, W, 3) display-encoded picture of Gaussians."""
        return _picture(self.arrays, gaussians, camera, low_pass)


def fitted_hierarchy(
    views: CutViews,
    hierarchy: Hierarchy,
    seed: int,
    steps: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Hierarchy, float, float]:
    """A hierarchy whose cuts look as its leaves do: with contrasts, and inner nodes that are fitted.

    Contrasts are measured before the fit, which is then of cuts as they will be drawn, and again after it.

    Args:
        steps: of the fit, each of which looks at a cut; as many more measure contrasts.
        seed, progress: as for `fitted_for_display`.

    Returns:
        The hierarchy, and the PSNR in dB of its cuts to pictures of the leaves, with inner nodes as given and
        with fitted ones, in views they were not fitted to yet. Fitted ones that are no better are left out.
    """
    first = steps // _MEASURED_BEFORE
    parts = [first, steps, steps - first]

    def told(part: int) -> Callable[[int, int], None]:
        return lambda done, total: progress(sum(parts[:part]) + done, sum(parts))

    hierarchy = _with_contrasts(views, hierarchy, [seed, 0], parts[0], told(0))
    hierarchy, before, after = _with_fitted_nodes(views, hierarchy, [seed, 1], parts[1], told(1))
    return _with_contrasts(views, hierarchy, [seed, 2], parts[2], told(2)), before, after


def _with_fitted_nodes(
    views: CutViews, hierarchy: Hierarchy, seeds: list[int], steps: int, progress: Callable[[int, int], None]
) -> tuple[Hierarchy, float, float]:
    """What `fitted_hierarchy` returns, with the contrasts that the hierarchy has."""
    leaves, arrays = views.leaves, views.arrays
    nodes = hierarchy.nodes(leaves)
    cut, own = HierarchyCut(arrays, nodes), leaves.to(arrays.device)
    inner = nodes.gaussians.part(len(leaves), len(nodes.gaussians))
    optimizer = GaussianOptimizer(inner, _STILLNESS * TYPICAL_DISTANCE / views.focal, arrays.device)
    former, errors = inner.to(arrays.device), np.zeros((0, 2))
    for step in range(steps):
        camera, low_pass, index = views.cut_at_random(cut, [*seeds, step])
        chosen = index.to(arrays.device)
        few, many = chosen[chosen >= len(leaves)] - len(leaves), chosen[chosen < len(leaves)]
        if len(few):
            finer = own.select(many)
            with torch.no_grad():
                truth = views.picture(own, camera, low_pass)
            now = concatenated([finer, optimizer.chosen(few)])
            difference = views.picture(now, camera, low_pass) - truth
            optimizer.step(difference.abs().mean(), step / steps)
            if step >= (1 - _JUDGED) * steps:
                with torch.no_grad():
                    before = concatenated([finer, former.select(few)])
                    given = views.picture(before, camera, low_pass) - truth
                both = [float(_squared(part.detach()).mean()) for part in (given, difference)]
                errors = np.append(errors, [both], axis=0)
        progress(step + 1, steps)
    fitted = replace(optimizer.gaussians, blending=leaves.blending)
    first, last = map(float, errors.mean(axis=0)) if len(errors) else (0.0, 0.0)
    found = replace(hierarchy, inner=fitted) if last < first else hierarchy
    return found, decibels(first), decibels(min(first, last))


def _with_contrasts(
    views: CutViews, hierarchy: Hierarchy, seeds: list[int], steps: int, progress: Callable[[int, int], None]
) -> Hierarchy:
    """A hierarchy whose contrasts are measured in pictures of so many cuts.

    Cuts that levels limit by extent times contrast then have nodes of about the same squared error each, so
    that no other cut of as many nodes is closer to the leaves.
    """

    def error(picture: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
        return _squared(picture - truth).mean(dim=2)

    found = _shown_by_nodes(views, hierarchy, seeds, steps, error, 2, progress).sqrt()
    return replace(hierarchy, contrast=found if found.any() else torch.full_like(found, USUAL_CONTRAST))


def visibility_of_nodes(
    views: CutViews,
    hierarchy: Hierarchy,
    seed: int,
    steps: int,
    difference: Difference,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> torch.Tensor:
    """(M,) float32, the visible differences that inner nodes make where their extent is one pixel.

    They grow with its fourth power: differences of contrast do with the square of what they are, and lie in
    as many pixels.

    Args:
        steps: of how many cuts pictures are compared.
        difference: of pictures and those of the leaves.
        seed, progress: as for `fitted_for_display`.
    """
    return _shown_by_nodes(views, hierarchy, [seed, 3], steps, difference, 4, progress)


def _shown_by_nodes(
    views: CutViews,
    hierarchy: Hierarchy,
    seeds: list[int],
    steps: int,
    difference: Difference,
    power: int,
    progress: Callable[[int, int], None],
) -> torch.Tensor:
    """(M,) float32, sums of differences that inner nodes make, over a power of their extents in pixels.

    The difference of each pixel is shared among the nodes that it shows, by their weights.
    """
    leaves, arrays = views.leaves, views.arrays
    nodes, count = hierarchy.nodes(leaves), len(leaves)
    cut, own, every = HierarchyCut(arrays, nodes), leaves.to(arrays.device), nodes.gaussians.to(arrays.device)
    means = rows_of(nodes.gaussians.means)
    sums, powers, seen = np.zeros((3, len(nodes.size)))
    for step in range(steps):
        camera, low_pass, index = views.cut_at_random(cut, [*seeds, step])
        number = index.numpy()
        ahead = np.linalg.norm(means[number] - camera.position, axis=1) - nodes.radius[number]
        inner = (number >= count) & (ahead > NEAR)
        if inner.any():
            drawn = every.select(index.to(arrays.device))
            with torch.no_grad():
                pictures = (views.picture(gaussians, camera, low_pass) for gaussians in (drawn, own))
                values = difference(*pictures)
            shares = _shares(arrays, drawn, camera, low_pass, values).cpu().numpy()
            number, ahead = number[inner], ahead[inner]
            sums[number] += np.maximum(shares[inner], 0)
            powers[number] += (nodes.extent[number] * max(camera.fx, camera.fy) / ahead) ** power
            seen[number] += 1
        progress(step + 1, steps)
    tree = CutTree(nodes.parent, count)
    return torch.from_numpy(np.float32(_over_powers(tree, sums[count:], powers[count:], seen[count:])))


def _squared(difference: torch.Tensor) -> torch.Tensor:
    return difference.clamp(-1, 1).square()


def _shares(
    arrays: Arrays, gaussians: Gaussians, camera: Camera, low_pass: float, values: torch.Tensor
) -> torch.Tensor:
    """(N,) sums of the values of pixels (H, W) by the weights of each Gaussian in them."""
    # So dark that radiance is a multiple of the perceptual value.
    dark = torch.full_like(gaussians.sh[:1], (0.5 * SRGB_DARK_VALUE - 0.5) / SH_DC).requires_grad_()
    image = render_differentiable(arrays, replace(gaussians, sh=dark, directional=None), camera, low_pass)
    slope = SH_DC / SRGB_SLOPE
    if gaussians.blending is Blending.DISPLAY:
        image, slope = perceptual_from_radiance(image), SH_DC
    (gradient,) = torch.autograd.grad((image[..., 0] * values).sum(), dark)
    return gradient[0, 0] / slope


def _over_powers(tree: CutTree, sums: Floats, powers: Floats, seen: Floats) -> Floats:
    """(M,) sums of inner nodes over the powers that they belong to, which were seen so many times.

    A node counts as seen once more, with what the node above it has. What has next to nothing gets a little.
    """
    usual = sums.sum() / max(powers.sum(), 1e-30)
    once = np.divide(powers, seen, out=np.ones_like(powers), where=seen > 0)
    found = np.append(np.zeros(len(sums)), usual)
    for nodes in tree.by_depth:
        above = found[tree.above[tree.leaves + nodes]]
        found[nodes] = (sums[nodes] + once[nodes] * above) / (powers[nodes] + once[nodes])
    return np.maximum(found[:-1], _LEAST_SHOWN * usual)


def _picture(arrays: Arrays, gaussians: Gaussians, camera: Camera, low_pass: float) -> torch.Tensor:
    return perceptual_from_radiance(render_differentiable(arrays, gaussians, camera, low_pass))


def _low_pass(camera: Camera, focal: float) -> float:
    """That of levels of detail, which are never drawn finer than the pixels that they were trained on."""
    return PIXEL_FILTER * max(1.0, camera.fy / focal) ** 2


def _cut_at_random(cut: HierarchyCut, camera: Camera, rng: np.random.Generator) -> torch.Tensor:
    corners = (-(-camera.height // TILE) + 1, -(-camera.width // TILE) + 1)
    levels = np.full(corners, _FINEST, dtype=np.float32)
    leaves = len(cut.nodes(camera, levels, 1.0)[0])
    most = round(leaves * float(np.exp(rng.uniform(np.log(_LEAST), np.log(_MOST)))))
    index, _ = cut.nodes(camera, levels * np.float32(cut.least_factor(camera, levels, most)), 1.0)
    return torch.from_numpy(np.sort(index.numpy().astype(np.int64)))


def _between(cameras: Sequence[Camera], focal: float, rng: np.random.Generator) -> Camera:
    """A part of a view between one of the cameras and another one, turned a little."""
    first, second = (cameras[index] for index in rng.integers(0, len(cameras), 2))
    pose, share = first.camera_to_world, rng.uniform(0, 0.5)
    pose[:3, 3] = (1 - share) * first.position + share * second.position
    pose[:3, :3] = turned(pose[:3, :3], *(_TURN * rng.normal(size=2)))
    times = focal / first.fy * max(1.0, 2 ** rng.uniform(-_CLOSER, _CLOSER))
    camera = first.at(pose).resized(*(max(1, round(times * side)) for side in (first.width, first.height)))
    left, top = (int(rng.integers(0, max(0, side - _SIDE) + 1)) for side in (camera.width, camera.height))
    return camera.cropped(left, top, min(_SIDE, camera.width), min(_SIDE, camera.height))


def views_around(gaussians: Gaussians, focal: float, seed: int) -> list[Camera]:
    """Views of Gaussians of which none are known: from amid them and around, towards some of them."""
    means, rng, cameras = rows_of(gaussians.means), np.random.default_rng(seed), []
    for _ in range(_VIEWS):
        first, second, target = means[rng.integers(0, len(means), 3)]
        # Never at the target itself.
        eye = first + rng.uniform(-_BEYOND, 1 + _BEYOND) * (second - first) + 1e-3 * rng.normal(size=3)
        pose = look_at(eye, target, rng.normal(size=3))
        cameras.append(camera_from_pose(pose, _SIDE, _SIDE, focal, focal, _SIDE / 2, _SIDE / 2))
    return cameras
