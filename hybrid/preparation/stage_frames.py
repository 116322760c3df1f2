"""Training frames of a preparation: views and samples by stage, noise, and what bounded light lacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np

from compose.camera.camera import Camera
from compose.image.colour import Image, decibels, srgb_from_radiance
from hybrid.preparation.decisions import CONVERGED_DB, GAUSSIANS, SAMPLES
from hybrid.preparation.forest_errors import finest_shown
from hybrid.preparation.stages import Stage
from pathtrace.dataset.frame_error import FrameError, frame_error, mean_frame_error
from pathtrace.dataset.growing import GrowingFrames, Wanted
from pathtrace.region import ViewingRegion
from pathtrace.region.neighbourhood import view_time
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest

# Side in pixels of views before they are given the size of a stage's frames.
_SIDE = 256
# Views whose error is looked at to know that of all.
_ASKED = 6
# More samples do not pay for a frame whose own error is less than this share of what the forest gets wrong in
# it.
_WORTHWHILE = 0.1


def stage_views(
    region: ViewingRegion,
    stages: Sequence[Stage],
    seed: int,
    had: Sequence[Camera] = (),
    elsewhere: int = 0,
) -> list[tuple[Camera, float]]:
    """All views of some stages, each with its scale; first those that there are already.

    As many of these as are `elsewhere` are none of the region's. Views larger than a frame may be are cut to
    a random part.
    """
    stage_of = [stage for stage in stages for _ in range(stage.views)]
    homes = region.views(len(stage_of) - elsewhere, _SIDE, _SIDE, seed + elsewhere)
    new = [
        _part(homes[index - elsewhere].resized(stage.whole, stage.whole), stage.side, [seed, index])
        for index, stage in list(enumerate(stage_of))[len(had) :]
    ]
    return [(view, stage.scale) for view, stage in zip([*had, *new], stage_of, strict=True)]


def _part(camera: Camera, side: int, seed: list[int]) -> Camera:
    """A random square part of a view, or all of it."""
    rng = np.random.default_rng(seed)
    left, top = (int(rng.integers(length - side + 1)) for length in (camera.width, camera.height))
    return camera.cropped(left, top, side, side)


def wanted_of(
    frames: GrowingFrames, views: list[tuple[Camera, float]], stage: Stage, forest: Forest | None
) -> list[Wanted]:
    """The samples that all views, given with their scales, get in a stage.

    More than they had only where their error matters beside that of the forest, if there is one yet.
    """
    had = frames.samples
    aimed = [stage.spp_at(scale) for _, scale in views]
    if forest is not None and had:
        show, asked = finest_shown(forest), frames.spread(_ASKED)
        # Squared error of denoised frames over that of what was traced, on average.
        errors = [_error(frames, number).mse for number in asked]
        share = float(np.sum(errors) / max(np.sum([_noise(frames, number) for number in asked]), 1e-12))
        for number, samples in enumerate(had):
            if samples < aimed[number]:
                # Its own error must be a noticeable part of its difference from the forest.
                noise, difference = _noise(frames, number), _difference(frames, number, show)
                aimed[number] = aimed[number] if share * noise > _WORTHWHILE * difference else samples
    return [
        Wanted(camera, max(spp, *had[number : number + 1], 2), view_time(frames.scene, number))
        for number, ((camera, _), spp) in enumerate(zip(views, aimed, strict=True))
    ]


def stated_error(frames: GrowingFrames) -> float:
    """PSNR in dB of the frames against the truth, as their samples tell."""
    return mean_frame_error([_error(frames, number) for number in frames.spread(_ASKED)]).psnr_db


def _error(frames: GrowingFrames, number: int) -> FrameError:
    return frame_error(*frames.halves(number), frames.radiance(number))


def _noise(frames: GrowingFrames, number: int) -> float:
    """Squared error of what was traced of a view, in sRGB values."""
    one, other = (srgb_from_radiance(half.radiance) for half in frames.halves(number))
    return float(np.mean((one - other) ** 2) / 4)


def _difference(frames: GrowingFrames, number: int, show: Callable[[Camera, float], Image]) -> float:
    """Squared difference of a forest from a frame, in sRGB values."""
    shown = show(frames.camera(number), frames.time(number))
    return float(np.mean((srgb_from_radiance(shown) - srgb_from_radiance(frames.radiance(number))) ** 2))


def trained_psnr(frames: GrowingFrames, forest: Forest) -> float:
    """PSNR in dB of a forest in the frames that it was trained on."""
    show = finest_shown(forest)
    return decibels(float(np.mean([_difference(frames, number, show) for number in frames.spread(_ASKED)])))


VIEWS = "views"


def limit_of(frames_db: float, trained_db: float, held_out_db: float) -> str:
    """What limits the quality of a forest most, by squared errors: SAMPLES, VIEWS, or GAUSSIANS.

    Frames lack samples by their own error; Gaussians, and steps to train them, are lacking by what a forest
    gets wrong in frames besides; views, by what it gets wrong elsewhere besides that. Arguments are PSNRs in
    dB: of the frames as they state it, of the forest in frames that it was trained on, and of the forest in
    held-out views.
    """
    of_frames, trained, held_out = (10 ** (-db / 10) for db in (frames_db, trained_db, held_out_db))
    shares = {SAMPLES: of_frames, GAUSSIANS: trained - of_frames, VIEWS: held_out - trained}
    return max(shares, key=shares.__getitem__)


# What doubling the samples of a denoised frame gains at least and at most, in dB; it was 1.0 (caustics) to
# 2.2 on five scenes, and is 3 without a denoiser.
_LEAST_GAIN, _MOST_GAIN = 0.5, 3.0


@dataclass(frozen=True)
class Pass:
    """What a pass over the frames has brought."""

    samples: float  # per pixel, mean over all frames so far
    error_db: float  # PSNR of the frames, as they state it
    seconds: float  # of tracing, over all passes so far


def converging_seconds(passes: Sequence[Pass]) -> float | None:
    """Seconds of tracing in all until the frames have CONVERGED_DB; None if they do, or nobody can tell.

    Each further doubling of the samples is taken to gain as much as those from the first pass to the last.
    """
    if len(passes) < 2 or passes[-1].error_db >= CONVERGED_DB:
        return None
    first, last = passes[0], passes[-1]
    if last.samples <= first.samples:
        return None
    gain = (last.error_db - first.error_db) / math.log2(last.samples / first.samples)
    doublings = (CONVERGED_DB - last.error_db) / min(max(gain, _LEAST_GAIN), _MOST_GAIN)
    return last.seconds * 2**doublings


# Side in pixels of the frames that tell, and their samples per pixel.
_CLAMPED_SIDE, _CLAMPED_SPP = 64, 64


def clamping_bias(bounded: Tracer, unbounded: Tracer, cameras: Sequence[Camera], seed: int) -> float:
    """Share of the mean radiance that a bound on indirect light removes, 0 to 1, over some views.

    Both tracers trace the same paths, so that the difference is the bound's alone; rare bright paths make it
    vary with the seed all the same.
    """
    total = [0.0, 0.0]
    for number, camera in enumerate(cameras):
        small = camera.resized(_CLAMPED_SIDE, _CLAMPED_SIDE)
        for index, tracer in enumerate((bounded, unbounded)):
            radiance = tracer.trace(small, frame_positions(small), _CLAMPED_SPP, seed + number).radiance
            total[index] += sum(float(dr.sum(channel)[0]) for channel in radiance)
    return 1 - total[0] / total[1] if total[1] else 0.0
