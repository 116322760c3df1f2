"""Fits the fusion network to a scene, with the estimates of a frame set as examples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields

import numpy as np
from scipy.ndimage import gaussian_filter

from compose.fusion.fitting import ITERATIONS, LEAST_SIZE, Example, fit
from compose.fusion.parents import Parents
from compose.image.colour import Image
from hybrid.frame.disc import DiscImages, denoised_for_fusion
from hybrid.frame.fusion import attach_fusion
from hybrid.runtime.device import device_arrays
from pathtrace.dataset.exr import read_estimate, read_frame
from pathtrace.dataset.frames import FrameEntry, FrameSet
from pathtrace.trace.image import TracedImage
from splat.lod.renderer import ForestRenderer
from splat.model.forest import Forest

# Examples per view in which the sample count varies; smallest and largest size, in pixels, of the patches of
# equal count.
_MIXED = 2
_PATCHES = 2.0, 12.0


def with_fusion(frames: FrameSet, forest: Forest, seed: int, progress: Callable[[int, int], None]) -> Forest:
    """The forest with a fusion network fitted to it; unchanged if the frame set has no example.

    Args:
        frames: their estimates are the examples, if they are large enough.
        forest: trained on the same frame set.
        seed: same seed, same network on the same machine.
        progress: called with steps done and steps in total.
    """
    examples = list(_examples(frames, forest, np.random.default_rng(seed)))
    return attach_fusion(forest, fit(examples, seed, progress)) if examples else forest


def fusion_steps(frames: FrameSet) -> int:
    """Number of steps that `with_fusion` takes."""
    return ITERATIONS if any(entry.estimates for entry in _usable(frames)) else 0


def _usable(frames: FrameSet) -> list[FrameEntry]:
    """The views and close-ups that training has not seen and that are large enough for an example."""
    return [
        entry
        for entry in frames.held_out + frames.close_ups
        if min(entry.camera.width, entry.camera.height) >= LEAST_SIZE
    ]


def _examples(frames: FrameSet, forest: Forest, rng: np.random.Generator) -> Iterator[Example]:
    """For each estimate of each view: the parents of a fovea, and the reference."""
    renderer = ForestRenderer(device_arrays(), forest)
    finest = len(forest.counts)
    for entry in _usable(frames):
        reference = read_frame(entry.file).radiance
        splat = np.array(renderer.render_layer(entry.camera, finest).image())
        enlargement = entry.camera.fy / forest.focal_of(finest)
        traced = [_images_of(read_estimate(file), spp) for spp, file in entry.estimates.items()]
        if len(traced) > 1:
            traced += [_mixed(traced, rng) for _ in range(_MIXED)]
        for images in traced:
            yield Example(_parents(images, splat, enlargement), reference)


def _images_of(estimate: TracedImage, spp: int) -> DiscImages:
    count = np.full((*estimate.radiance.shape[:2], 1), spp, dtype=np.float32)
    return DiscImages(estimate.radiance, estimate.albedo, estimate.normal, count)


def _parents(images: DiscImages, splat: Image, enlargement: float) -> Parents:
    denoised = denoised_for_fusion(images)
    unknown = np.full_like(denoised, np.inf)
    auxiliary = images.albedo, images.normal, images.count
    return Parents(images.radiance, unknown, denoised, splat, *auxiliary, enlargement)


def _mixed(traced: list[DiscImages], rng: np.random.Generator) -> DiscImages:
    """Two estimates in random patches, as a short history and adaptive sampling leave them."""
    one, other = (traced[index] for index in rng.choice(len(traced), 2, replace=False))
    noise = gaussian_filter(rng.normal(size=one.count.shape[:2]), rng.uniform(*_PATCHES))
    first = (noise > np.quantile(noise, rng.uniform(0.2, 0.8)))[..., None]
    mixed = (np.where(first, getattr(one, f.name), getattr(other, f.name)) for f in fields(DiscImages))
    return DiscImages(*mixed)
