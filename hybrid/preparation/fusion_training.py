"""Fits the fusion network to a scene, with the estimates of a frame set as examples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from compose.fusion.fitting import (
    ITERATIONS,
    LEAST_SIZE,
    TRIAL_ITERATIONS,
    Example,
    FusionReference,
    fit,
    prove,
    trials,
)
from compose.fusion.network import COUNTS, ENLARGEMENTS, MIXED
from compose.fusion.parents import IMAGES, Parents
from compose.image.colour import Image
from hybrid.preparation.forest_errors import finest_shown
from hybrid.preparation.training_views import Frames
from hybrid.render.disc_images import denoised_for_fusion
from hybrid.render.forest_attachments import attach_fusion, fusion_of
from pathtrace.dataset.captured_frames import read_estimate, read_frame, read_radiance
from pathtrace.dataset.frame_set import FrameEntry, FrameSet
from splat.model.forest import Forest

# Examples per view in which the sample count varies; smallest and largest size, in pixels, of the patches of
# equal count.
_MIXED = 2
_PATCHES = 2.0, 12.0
# Sides of an example in pixels, at most: of a larger view, each estimate shows another part.
_MOST = 256


def with_fusion(frames: Frames, forest: Forest, seed: int, progress: Callable[[int, int], None]) -> Forest:
    """The forest with a fusion fitted to it and tried on unseen views; unchanged without any example.

    Estimates of the frame set that it was trained on are the examples, if they are large enough. `progress`
    is called with steps done and steps in total.
    """
    examples = list(_examples(frames, forest, np.random.default_rng(seed)))
    if not examples:
        return forest
    total = fusion_steps(frames)
    proof = prove(examples, seed, lambda done, _: progress(done, total))
    fusion = fit(examples, seed, lambda done, _: progress(total - ITERATIONS + done, total))
    fusion.shares.copy_(torch.from_numpy(proof.shares))
    fusion.gains.copy_(torch.from_numpy(proof.gains))
    return attach_fusion(forest, fusion)


def fusion_steps(frames: Frames) -> int:
    """Number of steps that `with_fusion` takes."""
    views = {number for number, _ in _usable(frames)}
    return ITERATIONS + TRIAL_ITERATIONS * trials(len(views)) if views else 0


def fusion_verdicts(forest: Forest) -> list[dict[str, Any]]:
    """What a fused fovea shows, one row per denoiser, sample count and enlargement; empty without a fusion.

    Rows have quick (whether the quicker denoiser is used), spp, enlargement, the shares of network, denoised
    and splat, and gain_db over the better of the last two on unseen views; 0 where that one alone is shown,
    because the network did not prove to be better.
    """
    fusion = fusion_of(forest)
    if fusion is None:
        return []
    names = "quick", "spp", "enlargement", *MIXED, "gain_db"
    cells = product((False, True), COUNTS, ENLARGEMENTS)
    shares, gains = fusion.shares.flatten(0, 2).tolist(), fusion.gains.flatten().tolist()
    rows = zip(cells, shares, gains, strict=True)
    return [dict(zip(names, (*cell, *mixed, gain), strict=True)) for cell, mixed, gain in rows]


def _usable(frames: Frames) -> list[tuple[int, FrameEntry]]:
    """Number and entry of the views that training has not seen and that are large enough for an example.

    Close-ups have the number of the view that they are parts of: that at the same place. Third-party
    frames have no estimates.
    """
    if not isinstance(frames, FrameSet):
        return []
    numbers: dict[bytes, int] = {}
    found = []
    for entry in (entry for entry in frames.held_out + frames.close_ups if entry.halves):
        number = numbers.setdefault(entry.camera.camera_to_world.tobytes(), len(numbers))
        if min(entry.camera.width, entry.camera.height) >= LEAST_SIZE:
            found.append((number, entry))
    return found


def _examples(frames: Frames, forest: Forest, rng: np.random.Generator) -> Iterator[Example]:
    """For each estimate of each view and both denoisers: the parents of a fovea, and the reference.

    Images with numbers that are not finite are left out: one of them would spoil all weights of the network.
    """
    show, focal = finest_shown(forest), forest.focal_of(len(forest.counts))
    for number, entry in _usable(frames):
        one, other = (read_radiance(file, entry.size) for file in entry.halves)
        reference = FusionReference(read_frame(entry.file, entry.size).radiance, (one, other))
        if not _is_finite(reference.denoised, one, other):
            continue
        splat, enlargement = show(entry.camera, entry.time), entry.camera.fy / focal
        traced = []
        for spp, file in entry.estimates.items():
            found = read_estimate(file, entry.size)
            count = np.full((*found.radiance.shape[:2], 1), spp, dtype=np.float32)
            images = found.radiance, found.albedo, found.normal
            if _is_finite(*images):
                traced.append(_Estimate(*images, count))
        if len(traced) > 1:
            traced += [_mixed(traced, rng) for _ in range(_MIXED)]
        for estimate, quick in product(traced, (False, True)):
            tensors = [mi.TensorXf(image) for image in estimate[:3]]
            denoised = np.array(denoised_for_fusion(tensors, quick))
            unknown, features = np.full_like(denoised, np.inf), estimate[1:]
            parents = Parents(estimate.radiance, unknown, denoised, splat, *features, enlargement, quick)
            yield _part(Example(parents, reference, number), rng)


def _is_finite(*images: Image) -> bool:
    return all(np.isfinite(image).all() for image in images)


class _Estimate(NamedTuple):
    """A path-traced estimate of a view, (H, W, 3) each, and its samples per pixel (H, W, 1)."""

    radiance: Image
    albedo: Image
    normal: Image
    samples: Image


def _mixed(traced: list[_Estimate], rng: np.random.Generator) -> _Estimate:
    """Two estimates in random patches, as a short history and adaptive sampling leave them."""
    one, other = (traced[index] for index in rng.choice(len(traced), 2, replace=False))
    noise = gaussian_filter(rng.normal(size=one.samples.shape[:2]), rng.uniform(*_PATCHES))
    first = (noise > np.quantile(noise, rng.uniform(0.2, 0.8)))[..., None]
    return _Estimate(*(np.where(first, a, b) for a, b in zip(one, other, strict=True)))


def _part(example: Example, rng: np.random.Generator) -> Example:
    """A random part of an example that is too large."""
    height, width = example.parents.traced.shape[:2]
    if max(height, width) <= _MOST:
        return example
    top, left = (int(rng.integers(max(side - _MOST, 0) + 1)) for side in (height, width))
    box = np.s_[top : top + _MOST, left : left + _MOST]
    parents, reference = example.parents, example.reference
    one, other = reference.halves
    return replace(
        example,
        parents=replace(parents, **{name: getattr(parents, name)[box] for name in IMAGES}),
        reference=FusionReference(reference.denoised[box], (one[box], other[box])),
    )
