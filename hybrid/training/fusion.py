"""Fitting the fusion on a frame set, and finding it in a forest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from compose.fusion.fitting import ITERATIONS, LEAST_SIZE, Example, fit
from compose.fusion.parents import Parents
from compose.image.colour import Image
from hybrid.frame.disc import denoised_for_fusion
from hybrid.frame.fusion import FUSION_PREFIX
from pathtrace.dataset.exr import Estimate, read_estimate, read_frame
from pathtrace.dataset.frames import FrameEntry, FrameSet
from splat.base.arrays import Arrays
from splat.lod.pictures import ForestRenderer
from splat.model.forest import Forest

# Examples per view whose pixels have different numbers of samples, and the size of the patches that have the
# same one, in pixels.
_MIXED = 2
_PATCHES = 2.0, 12.0


def with_fusion(
    arrays: Arrays, frames: FrameSet, forest: Forest, seed: int, progress: Callable[[int, int], None]
) -> Forest:
    """The forest, with a fusion fitted on the frame set's estimates; without any that are
    large enough, as it is."""
    examples = list(_examples(arrays, frames, forest, np.random.default_rng(seed)))
    if not examples:
        return forest
    fusion = fit(examples, seed, progress)
    return replace(
        forest,
        attached={FUSION_PREFIX + name: tensor.clone() for name, tensor in fusion.state_dict().items()},
    )


def fusion_steps(frames: FrameSet) -> int:
    """Steps of the fit that `with_fusion` makes."""
    return ITERATIONS if any(entry.estimates for entry in _usable(frames)) else 0


def _usable(frames: FrameSet) -> list[FrameEntry]:
    """Views that training has not seen, and parts of them, that are large enough to fit the fusion to."""
    return [
        entry
        for entry in frames.held_out + frames.close_ups
        if min(entry.camera.width, entry.camera.height) >= LEAST_SIZE
    ]


def _examples(
    arrays: Arrays, frames: FrameSet, forest: Forest, rng: np.random.Generator
) -> Iterator[Example]:
    """What foveas would be made of in the views that have estimates, and what they should be."""
    renderer = ForestRenderer(arrays, forest)
    for entry in _usable(frames):
        reference = read_frame(entry.file).radiance
        finest = len(forest.counts)
        splat = np.array(renderer.render_layer(entry.camera, finest).image())
        enlargement = entry.camera.fy / forest.focal_of(finest)
        traced = [_Traced.of(read_estimate(file), spp) for spp, file in entry.estimates.items()]
        if len(traced) > 1:
            traced += [_mixed(traced, rng) for _ in range(_MIXED)]
        for estimate in traced:
            yield Example(estimate.parents(splat, enlargement), reference)


@dataclass(frozen=True)
class _Traced:
    """An estimate (H, W, 3) with its auxiliary features, and how many samples each pixel has, (H, W, 1)."""

    radiance: Image
    albedo: Image
    normal: Image
    count: Image

    @staticmethod
    def of(estimate: Estimate, spp: int) -> _Traced:
        count = np.full((*estimate.radiance.shape[:2], 1), spp, dtype=np.float32)
        return _Traced(estimate.radiance, estimate.albedo, estimate.normal, count)

    def parents(self, splat: Image, enlargement: float) -> Parents:
        denoised = denoised_for_fusion(self.radiance, self.albedo, self.normal, float(self.count.mean()))
        unknown = np.full_like(denoised, np.inf)
        auxiliary = self.albedo, self.normal, self.count
        return Parents(self.radiance, unknown, denoised, splat, *auxiliary, enlargement)


def _mixed(traced: list[_Traced], rng: np.random.Generator) -> _Traced:
    """One estimate here, another there: as where history is thin, and where samples go where they help."""
    one, other = (traced[index] for index in rng.choice(len(traced), 2, replace=False))
    hills = gaussian_filter(rng.normal(size=one.count.shape[:2]), rng.uniform(*_PATCHES))
    here = (hills > np.quantile(hills, rng.uniform(0.2, 0.8)))[..., None]
    both = (np.where(here, getattr(one, f.name), getattr(other, f.name)) for f in fields(_Traced))
    return _Traced(*both)
