"""Baselines at the cost of the hybrid frame: the rays with which each takes as long, the best settings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from compose.image.colour import Image
from hybrid.base.progress import Steps
from hybrid.evaluation.baselines import Tuning, WarpTuning, disc_over, warped
from hybrid.evaluation.baselines_traced import enlarged
from hybrid.evaluation.methods import Family, Method
from hybrid.evaluation.results import TOLERANCE
from hybrid.measure.frame_times import jittered_view, path_around, ratio_of_medians
from hybrid.measure.image_metrics import has_valid, regions, ssim_map, valid_mean
from pathtrace.trace.tracer import Tracer

# By the frames of a trial, by how much (in logarithms) times may differ for the trial to go on; with the most
# frames, for it to end the search. Few frames suffice to tell that a trial is far off.
_ENDURED = {3: 0.25, 6: 0.08, 9: 0.04}
_TRIALS = 10
# Steps past rays that round to settings that were tried.
_STEPS = 12
# Frames before the trials, while kernels are compiled.
_WARM_UP = 2
# Time grows by about this power of rays, and by a least one; the longest step in rays without trials on both
# sides; and how near a guess may come to a trial on either side, as a share of the way between both.
_POWER, _LEAST_POWER, _LONGEST, _NEAREST = 0.8, 0.05, 8.0, 0.15
# What is tried: f of RMFR's mapping, samples per pixel, and shares of the rays in a disc.
_F = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)
_SPP = (1, 2, 4)
_SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8)


def rays_at_equal_time(
    families: Mapping[str, Family],
    ours: Method,
    view: View,
    gaze: Gaze,
    first: Mapping[str, float],
    progress: Steps,
) -> dict[str, float | None]:
    """By the names of the families, rays per pixel at which each takes about as long as our frame in a view.

    All take turns, because the machine's speed drifts, their gazes along a path around `gaze`; no frame
    reuses what another one has computed. The `first` rays are tried first, and time must grow with rays. None
    where even the cheapest trial took over TOLERANCE longer.
    """
    searches = {name: _Search(family, first[name]) for name, family in families.items()}
    rounds = _TRIALS * max(_ENDURED)
    path = path_around(gaze, max(_ENDURED))
    for turn in range(-_WARM_UP, rounds):
        open_ = [search for search in searches.values() if not search.is_over]
        if not open_:
            break
        methods = [ours, *(search.method for search in open_)]
        milliseconds = []
        for place, method in enumerate(methods):
            number = (turn + _WARM_UP) * (1 + len(searches)) + place
            frame = method.render(jittered_view(view, number), path[turn % len(path)], turn + _WARM_UP)
            milliseconds.append(frame.milliseconds["total"])
        for search, own in zip(open_, milliseconds[1:], strict=True):
            if turn >= 0:
                search.add(own, milliseconds[0])
        progress(sum(search.is_over for search in searches.values()), len(searches))
    return {name: search.found for name, search in searches.items()}


class _Search:
    """The search for a family's rays, one trial after the other."""

    def __init__(self, family: Family, rays: float):
        self._family, self._trials = family, dict[str, tuple[float, float]]()
        self.is_over = False
        self._begin(rays)

    def _begin(self, rays: float) -> None:
        self.rays, self.method = rays, self._family(rays)
        self._own: list[float] = []
        self._ours: list[float] = []

    def add(self, own: float, ours: float) -> None:
        """Adds a frame's milliseconds and those of our frame in the same turn; may go on to other rays."""
        self._own.append(own)
        self._ours.append(ours)
        count = len(self._own)
        if count not in _ENDURED:
            return
        ratio = ratio_of_medians(self._own, self._ours)
        met = abs(math.log(ratio)) <= _ENDURED[count]
        if met and count < max(_ENDURED):
            return
        # Whole samples: other rays may well be the same settings.
        self._trials[str(self.method.settings)] = self.rays, ratio
        rays = None if met or len(self._trials) == _TRIALS else self._next()
        if rays is None:
            self.is_over = True
        else:
            self._begin(rays)

    def _next(self) -> float | None:
        """Rays that should meet our time and have settings that were not tried; None if there are none."""
        guesses = (rays for rays in self._guesses() if str(self._family(rays).settings) not in self._trials)
        return next(guesses, None)

    def _guesses(self) -> Iterator[float]:
        """Rays that should meet our time, the most likely first: others may be settings that were tried."""
        trials = sorted(self._trials.values())
        below = max((trial for trial in trials if trial[1] <= 1), default=None)
        above = min((trial for trial in trials if trial[1] > 1), default=None)
        if below is not None and above is not None and below[0] < above[0]:
            low, high = math.log(below[1]), math.log(above[1])
            likely = min(max(-low / (high - low), _NEAREST), 1 - _NEAREST)
            shares = np.linspace(0, 1, _STEPS + 2)[1:-1]
            for share in [likely, *sorted(shares, key=lambda share: abs(share - likely))]:
                yield below[0] * (above[0] / below[0]) ** float(share)
            return
        # The two trials that are nearest to our time say how it grows.
        (rays, ratio), *others = trials if below is None else trials[::-1]
        power = _POWER
        if others and others[0][0] != rays:
            power = math.log(ratio / others[0][1]) / math.log(rays / others[0][0])
        step = ratio ** (-1 / max(power, _LEAST_POWER))
        step = min(max(step, 1 / _LONGEST), _LONGEST)
        for number in range(1, _STEPS + 1):
            yield rays * step**number

    @property
    def found(self) -> float | None:
        """The rays of the trial that came nearest, of those that took no more than TOLERANCE longer."""
        within = [trial for trial in self._trials.values() if trial[1] <= 1 + TOLERANCE]
        return min(within, key=lambda trial: abs(math.log(trial[1])))[0] if within else None


def tuned(
    tracer: Tracer,
    views: list[View],
    references: list[Image],
    foveation: Foveation,
    rays: float,
    progress: Steps,
) -> Tuning:
    """The settings with the highest mean SSIM, of the whole frame and of the fovea, at a number of rays.

    They are tuned on views with references (H, W, 3), linear radiance; rays are per pixel of the frame. The
    disc over an enlarged frame gets the share of the rays with the highest sum of both.
    """
    # With fewer samples per pixel than `rays`, the smaller image would be larger than the frame.
    counts = [spp for spp in _SPP if spp >= rays] or [math.ceil(rays)]
    warps = [WarpTuning(*settings) for settings in product(_F, counts, (False, True))]
    total = len(warps) + len(counts) + len(_SHARES)
    foveas = [regions(foveation, truth)["foveal"].mask.astype(np.float32) for truth in references]
    # All pixels count where SSIM has no value in the fovea.
    weights = [fovea if has_valid(fovea) else None for fovea in foveas]
    done = 0

    def scores(baselines: Iterable[Method]) -> NDArray[np.float64]:
        """(baselines, 2) mean SSIM of the whole frame and of the fovea."""
        nonlocal done
        found = []
        for baseline in baselines:
            images = [baseline.render(view, foveation.gaze, seed).image for seed, view in enumerate(views)]
            maps = [ssim_map(image, truth) for image, truth in zip(images, references, strict=True)]
            pairs = zip(maps, weights, strict=True)
            found.append([[valid_mean(one), valid_mean(one, weight)] for one, weight in pairs])
            done += 1
            progress(done, total)
        return np.mean(found, axis=1)

    frame, fovea = (
        warps[best] for best in scores(warped(tracer, tuning, rays) for tuning in warps).argmax(axis=0)
    )
    smaller = scores(enlarged(tracer, spp, rays, denoised=True) for spp in counts)
    spp = counts[int(smaller[:, 0].argmax())]
    split = scores(disc_over(tracer, foveation, spp, share, rays) for share in _SHARES)
    return Tuning(frame, fovea, spp, _SHARES[int(split.sum(axis=1).argmax())])
