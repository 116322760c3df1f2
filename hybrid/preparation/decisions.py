"""The decisions of a plan, each with its numbers, and what a user may decide instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.base.traced_samples import DIFFUSE, SPECULAR
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS, DEFAULT_ACUITY_MODEL
from compose.eye.detail import LayerRange, detail_map
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.image.colour import LEAST_ERROR, decibels, luminance, srgb_from_radiance
from hybrid.preparation.scene_look import HALF_SPP, Look
from hybrid.preparation.stages import Needs
from hybrid.render.frame_settings import MOST_SPP
from pathtrace.dataset.frame_error import frame_error, mean_frame_error
from pathtrace.region import NEAR, ViewingRegion
from pathtrace.region.view_coverage import ViewCoverage
from pathtrace.scene.scene import DEPTH, ROULETTE, RUSSIAN_ROULETTE_DEPTH, Scene
from pathtrace.scene.triangles import Surfaces
from pathtrace.trace.path_depths import MOST_SEGMENTS, UNBOUNDED, depth_shares, path_costs
from splat.model.gaussians import MAX_DEGREE, sh_count
from splat.training.clusters import HitTree
from splat.training.initialization import hits_of
from splat.training.training_view import place_of, placed

Value = int | float | str | bool


@dataclass(frozen=True)
class Decision:
    """What a scene requires of one part of the renderers."""

    name: str
    value: Value
    fixed: Value  # what would be taken for a scene that nobody has looked at
    evidence: dict[str, Any]  # the numbers that decide, by name
    gain: float  # how many times less `of` there is than with the fixed value; 1 for as much
    of: str  # what the gain counts, such as "segments per path"


# Share of the mean radiance that may be lost to a bound on the length of paths.
MOST_BIAS = 0.005
# Paths per view that are measured, for radiance and for costs.
_PATHS, _COSTED = 1 << 15, 1 << 13
# Depths of roulette that are tried beside the usual one, and the least gain for another one, or for a bound.
_TRIED, _LEAST_PATH_GAIN = (3, 8), 1.1


def path_decisions(scene: Scene, cameras: Sequence[Camera], seed: int) -> list[Decision]:
    """The depth of paths, and that of roulette, which suit all views together.

    In participating media, whose paths are those of Mitsuba, they stay as they are.
    """
    if scene.optics.has_media:
        own = ((DEPTH, scene.own_depth, UNBOUNDED), (ROULETTE, scene.roulette_depth, RUSSIAN_ROULETTE_DEPTH))
        return [Decision(*each, {"has_media": True}, 1.0, "segments per path") for each in own]
    shares = depth_shares(scene, cameras, _PATHS, seed)
    needed = max(shares.depth_for(MOST_BIAS), 2)
    tried = [(most, RUSSIAN_ROULETTE_DEPTH) for most in (needed, UNBOUNDED)]
    bounded, unbounded = (cost.segments for cost in path_costs(scene, cameras, _COSTED, tried, seed))
    pays = unbounded >= _LEAST_PATH_GAIN * bounded
    evidence = {
        "share_by_depth": [round(float(share), 6) for share in shares.shares[:needed]],
        "needed": needed,
        "beyond": shares.beyond(needed),
        "beyond_error": shares.error_beyond(needed),
        "beyond_own_depth": shares.beyond(scene.own_depth),
        "most": MOST_BIAS,
        "is_bounded": needed < MOST_SEGMENTS,
        "segments": bounded,
        "segments_unbounded": unbounded,
    }
    # A bound only if it saves something: a small share of all radiance may be all of what is seen in glass.
    depth, gain = (needed, unbounded / bounded) if pays else (UNBOUNDED, 1.0)
    bound = Decision(DEPTH, depth, UNBOUNDED, evidence, gain, "segments per path")
    return [bound, _roulette(scene, cameras, depth, seed)]


def _roulette(scene: Scene, cameras: Sequence[Camera], depth: int, seed: int) -> Decision:
    """The least work for equal noise: segments times variance."""
    tried = (RUSSIAN_ROULETTE_DEPTH, *_TRIED)
    costs = path_costs(scene, cameras, _COSTED, [(depth, roulette) for roulette in tried], seed)
    work = {roulette: cost.segments * cost.variance for roulette, cost in zip(tried, costs, strict=True)}
    best = min(work, key=work.__getitem__)
    if work[RUSSIAN_ROULETTE_DEPTH] < _LEAST_PATH_GAIN * work[best]:
        best = RUSSIAN_ROULETTE_DEPTH
    gain = work[RUSSIAN_ROULETTE_DEPTH] / work[best] if work[best] else 1.0
    evidence = {"work": {str(roulette): work[roulette] for roulette in sorted(work)}}
    return Decision(ROULETTE, best, RUSSIAN_ROULETTE_DEPTH, evidence, gain, "segments for equal noise")


# Share of the pixels that must show gloss for Gaussians to have directional harmonics, and their degree where
# they do; of the degree above, `room` gains next to nothing.
_LEAST_GLOSS, _DEGREE = 0.002, 2
DEGREE = "degree"
# Shares of the pixels between which radiance is said to range.
_LEAST, _MOST = 0.01, 0.999
# Precision of the frames that a training keeps in memory. The first one holds radiance up to 65,504 in steps
# finer than those of a 10-bit display; a look misses what is brighter and small.
FRAME_PRECISION, HALF, SINGLE = "frame precision", "float16", "float32"
_LARGEST_IN_HALF = 16_000.0


def degree_decision(look: Look) -> Decision:
    """The degree of the spherical harmonics."""
    gloss = np.concatenate([classes.ravel() for classes in look.gloss])
    reflected = np.concatenate([mask.ravel() for mask in look.reflected])
    share, specular = (float((part | reflected).mean()) for part in (gloss != DIFFUSE, gloss == SPECULAR))
    degree = _DEGREE if share > _LEAST_GLOSS and not look.is_one_point else 0
    gain = sh_count(MAX_DEGREE) / sh_count(degree)
    one_point = look.is_one_point
    evidence = {"turning": share, "is_one_point": one_point, "specular": specular, "least": _LEAST_GLOSS}
    return Decision(DEGREE, degree, MAX_DEGREE, evidence, gain, "harmonics per Gaussian")


def frame_precision_decision(look: Look) -> Decision:
    """The precision of frames in memory, by how far radiance ranges.

    Its evidence is factors of two between dark and bright pixels, and the largest radiance of a channel.
    """
    shown = np.concatenate([luminance(image).ravel() for image in look.radiance])
    largest = max((float(image.max(initial=0)) for image in look.radiance), default=0.0)
    lit = shown[shown > 0]
    stops = float(np.log2(np.divide(*np.quantile(lit, [_MOST, _LEAST])))) if len(lit) else 0.0
    precision = HALF if largest <= _LARGEST_IN_HALF else SINGLE
    evidence = {"stops": stops, "largest": largest}
    gain = 2.0 if precision == HALF else 1.0
    return Decision(FRAME_PRECISION, precision, SINGLE, evidence, gain, "memory of frames")


LAYERS, FIXED_LAYERS = "layers", 4
# Gazes that decide: from the corner, most of the frame is far.
_GAZES = Gaze(0.0, 0.0), Gaze(0.5, 0.5)
# Radius of the full-quality region in percent of the height: the smaller, the more is periphery.
_FOV_B = 10.0
# Gaussians of a layer over those of the next finer one.
_COARSER = 0.57
# Layers of frames that show no more detail than the finest one, in cycles per pixel.
_NYQUIST = 0.5


def layers_decision(display: Display, size: tuple[int, int]) -> Decision:
    """Layers that any gaze draws on a frame of a width and height in pixels, shown on a display.

    By the acuity model that frames have unless told otherwise.
    """
    all_layers, coarsest = LayerRange(_NYQUIST, (0,) * FIXED_LAYERS), FIXED_LAYERS
    for gaze in _GAZES:
        detail = detail_map(display, gaze, *size, ACUITY_MODELS[DEFAULT_ACUITY_MODEL], _FOV_B, all_layers)
        shown = [step.layer for number, step in enumerate(detail.steps) if (detail.weight(number) > 0).any()]
        coarsest = min(coarsest, *shown)
    layers = FIXED_LAYERS - coarsest + 1
    evidence = {"pixels_per_degree": display.pixels_per_degree, "least_side": min(size)}
    total = [sum(_COARSER**step for step in range(count)) for count in (FIXED_LAYERS, layers)]
    return Decision(LAYERS, layers, FIXED_LAYERS, evidence, total[0] / total[1], "Gaussians in all layers")


DENOISED, RAW = "denoised", "raw"
SAMPLES, DENOISING = "samples", "denoising"
# Samples by which denoising must stand in for more, at least.
_LEAST_DENOISING_GAIN = 1.2
# Samples per pixel of training frames where nothing is known, and the range of those that are planned.
FIXED_SAMPLES, _RANGE = 32, (16, 128)
# Frames of this PSNR in dB limit no forest noticeably: the best ones of 40,000 Gaussians have about as much.
# With frames of 34 dB, `veach-bidir` lost 0.4 dB.
CONVERGED_DB = 35.0
# What doubling the samples of a frame gains in dB.
_GAIN_DB = {DENOISED: 1.5, RAW: 3.0}


def sample_decisions(look: Look) -> list[Decision]:
    """Samples per pixel of training frames, and whether to denoise frames of few samples.

    Both errors are stated from two independent halves: that of a raw half from their difference, that of the
    frame denoised from both as in pathtrace.dataset.frame_error. Squared noise falls with the samples, which
    tells how many raw frames take to be as close to the truth.
    """
    pairs = [[srgb_from_radiance(half.radiance) for half in halves] for halves in look.halves]
    raw = float(np.mean(np.square([one - other for one, other in pairs]))) / 2
    frames = zip(look.halves, look.denoised, strict=True)
    denoised = mean_frame_error([frame_error(*halves, denoised) for halves, denoised in frames]).mse
    gain = max(raw / 2, LEAST_ERROR) / max(denoised, LEAST_ERROR)
    kind, gain = (DENOISED, gain) if gain >= _LEAST_DENOISING_GAIN else (RAW, 1.0)
    spp = 2 * HALF_SPP
    errors = {"raw_spp": HALF_SPP, "raw_db": decibels(raw)}
    errors |= {"denoised_spp": spp, "denoised_db": decibels(denoised)}
    found_db = decibels(denoised if kind == DENOISED else raw / 2)
    doublings = np.ceil((CONVERGED_DB - found_db) / _GAIN_DB[kind])
    samples = int(np.clip(spp * 2.0 ** np.clip(doublings, -8, 8), *_RANGE))
    needed = {"spp": spp, "db": found_db, "wanted_db": CONVERGED_DB, "db_per_doubling": _GAIN_DB[kind]}
    return [
        Decision(SAMPLES, samples, FIXED_SAMPLES, needed, FIXED_SAMPLES / samples, "samples to trace"),
        Decision(DENOISING, kind, RAW, errors, gain, "samples for equal error"),
    ]


REGION = "region"


def region_decision(region: str, look: Look, breadth: float) -> Decision:
    """Where viewers are, in a region of some breadth (`breadth_of`); frames and Gaussians follow from it."""
    evidence = {"parallax": look.parallax, "is_one_point": look.is_one_point, "breadth": breadth}
    return Decision(REGION, region, NEAR, evidence, 1 / breadth, "views to train on")


# Squared differences of colours on the perceptual scale, summed over the pixels of a frame, above which a
# part of a surface is more than one Gaussian in its mean colour should stand for.
_VISIBLE = 1 / 32
# Gaussians for each such part that the look has seen, which misses some of what all training views show. In
# a minute on two cores, 4 instead of 2.5 gain 0.2 to 1.8 dB on `room`, foliage and cluttered rooms, and lose
# up to 0.3 dB on thin trusses and `staircase2`. Where something moves, a step takes the longer the more there
# are: there, 4 lose 0.6 dB in three minutes.
_PER_PART, _PER_MOVING_PART = 4.0, 2.5
# Numbers for which the plan says what they would leave.
_TRIED_COUNTS = (10_000, 30_000, 100_000, 300_000)

# Gaussians of the finest layer where nothing is known of a scene.
GAUSSIANS, FIXED_GAUSSIANS = "gaussians", 40_000
_ROUNDED = 100


def gaussians_decision(look: Look, breadth: float, moves: bool = False) -> Decision:
    """The number of Gaussians of the finest layer, for a region of some breadth (`breadth_of`).

    Its evidence has the dB that frames would have if as many Gaussians each had one colour (`error_db`), of a
    look's few frames: how fast that rises tells what more Gaussians would bring.
    """
    parts, curve, each = 1, {}, _PER_MOVING_PART if moves else _PER_PART
    if any(len(view.surface_pixels) for view in look.shown):
        place = place_of(look.shown)
        tree = HitTree(hits_of([placed(view, place) for view in look.shown]))
        parts = tree.count_of(_VISIBLE * len(look.shown))
        curve = {str(count): tree.psnr_of(round(count / each)) for count in _TRIED_COUNTS}
    needs = Needs(breadth, parts * each / FIXED_GAUSSIANS)
    count = max(_ROUNDED, round(FIXED_GAUSSIANS * needs.gaussians / _ROUNDED) * _ROUNDED)
    evidence = {"parts": parts, "breadth": breadth, "frames": len(look.shown), "error_db": curve}
    return Decision(GAUSSIANS, count, FIXED_GAUSSIANS, evidence, FIXED_GAUSSIANS / count, "Gaussians")


def planned_needs(plan: Mapping[str, Value], region: str, breadth: float) -> Needs:
    """What a region takes, as planned for it or for the default one; as `room` does if neither is planned.

    The plan, values by name, may be empty; `region` is as it was asked for, `breadth` that of `breadth_of`.
    """
    if GAUSSIANS not in plan or plan[REGION] not in (region, NEAR):
        return Needs(breadth)
    share = int(plan[GAUSSIANS]) / FIXED_GAUSSIANS
    of_plan = Needs(breadth) if plan[REGION] == region else Needs()
    return Needs(breadth, share / of_plan.gaussians)


# Side in pixels of views that tell it.
_BREADTH_SIDE = 256
# Views that the default region takes at first; how many that see enough is tried in these numbers.
_ORDINARY_VIEWS, _TRIED_VIEWS = 32, (32, 48, 64, 96, 128, 192, 256, 384)
_ENOUGH = 0.95
_ASKERS = 24


def breadth_of(region: ViewingRegion, surfaces: Surfaces, seed: int) -> float:
    """How many times as many views as the default region a region takes until little is unseen; 1 to 12."""
    if region.name == "near":
        return 1.0
    views = region.views(_TRIED_VIEWS[-1], _BREADTH_SIDE, _BREADTH_SIDE, seed)
    askers = region.unseen_views(_ASKERS, _BREADTH_SIDE, _BREADTH_SIDE, seed + 1)
    coverage, before = ViewCoverage(surfaces, []), 0
    for count in _TRIED_VIEWS:
        coverage.add(views[before:count])
        before = count
        if np.mean([coverage.share(view) for view in askers]) >= _ENOUGH:
            break
    return before / _ORDINARY_VIEWS


# Least and greatest whole number that each item may be.
_NUMBERS = {
    DEPTH: (1, 1_000_000),
    ROULETTE: (1, 1_000_000),
    DEGREE: (0, MAX_DEGREE),
    LAYERS: (1, 32),
    GAUSSIANS: (1, 100_000_000),
    SAMPLES: (1, MOST_SPP),
}
_WORDS = {DENOISING: (DENOISED, RAW), FRAME_PRECISION: (HALF, SINGLE)}


def parsed(given: Sequence[str]) -> dict[str, Value]:
    """Values by name, from texts such as "degree=0"; UserError if there is no such item or value."""
    found: dict[str, Value] = {}
    for text in given:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise UserError(f"{text}: must be NAME=VALUE")
        found[name] = _value(name, value)
    return found


def _value(name: str, value: str) -> Value:
    if name in _NUMBERS:
        least, most = _NUMBERS[name]
        if not value.isascii() or not value.isdigit() or not least <= int(value[:12]) <= most:
            raise UserError(f"{name}={value}: must be a whole number from {least} to {most}")
        return int(value)
    if name in _WORDS:
        if value not in _WORDS[name]:
            raise UserError(f"{name}={value}: must be {' or '.join(_WORDS[name])}")
        return value
    names = ", ".join((*_NUMBERS, *_WORDS))
    raise UserError(f"{name}={value}: must be one of {names}; the scene decides all else")
