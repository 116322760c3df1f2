"""Traces the disc: distributes its samples, and reuses those of earlier frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from compose.camera.camera import Camera
from compose.fovea.adaptive import allotted, disagreement
from compose.fovea.history import History
from compose.fovea.movers import Moment
from compose.fovea.region import FoveaRegion
from compose.fovea.samples import Samples, averaged_features, merged, put, taken
from hybrid.frame.disc import parents_of
from hybrid.frame.underlay import Underlay, underlay_of
from hybrid.runtime.device import device_arrays
from pathtrace.trace.film import interleaved, pixel_positions
from pathtrace.trace.first_hit import AuxiliaryFeatures
from pathtrace.trace.tracer import Traced, Tracer, auxiliary_spp, features_along

# From this many samples per pixel on, a share of them is traced everywhere; it shows where the others are
# needed.
_ADAPTIVE_FROM = 4
_FIRST_SHARE = 0.25
_FEWEST_FIRST = 2
_SECOND_STREAM = 0x5EED0000
# With a history, the few samples of each frame add up; the auxiliary features must be good enough for all.
_AUXILIARY_SPP_WITH_HISTORY = 8
# Side in pixels of the window in which samples are counted to find out where they are missing.
_WINDOW = 5


@dataclass(frozen=True)
class DiscRequest:
    """The samples that a frame requires.

    Attributes:
        camera: the view.
        region: the disc.
        spp: samples per pixel, on average over the disc.
        seed: same seed, same samples.
        auxiliary: whether albedo and normal are required.
    """

    camera: Camera
    region: FoveaRegion
    spp: int
    seed: int
    auxiliary: bool = True


class DiscTracer:
    """Traces the discs of one scene.

    Args:
        tracer: of the scene.
        history: whether samples of earlier frames are reused.
    """

    def __init__(self, tracer: Tracer, history: bool):
        self._tracer = tracer
        self._history = History(device_arrays()) if history else None

    @property
    def has_history(self) -> bool:
        """Whether samples of earlier frames are reused."""
        return self._history is not None

    def forget(self) -> None:
        """Drops all samples of earlier frames."""
        if self._history is not None:
            self._history = History(device_arrays())

    def show(self, moment: Moment) -> None:
        """Says which moment of a scene that moves is traced from now on."""
        if self._history is not None:
            self._history.show(moment)

    def history_state(self) -> dict[str, NDArray[np.generic]]:
        """Arrays to save for `restore_history`; empty without a history."""
        return {} if self._history is None else self._history.state()

    def restore_history(self, camera: Camera, state: dict[str, NDArray[np.generic]]) -> None:
        """Continues from the saved samples of a camera's view; does nothing if none were saved."""
        if state:
            self._history = History.restored(device_arrays(), camera, state)

    def trace(self, request: DiscRequest, underlay: Underlay | None = None, quick: bool = False) -> Samples:
        """Samples of the disc's pixels, merged with what is known of them.

        Args:
            request: which samples.
            underlay: the splats under the disc; with them, samples go where they help most. Without them, and
                at low sample counts, all pixels get the same number.
            quick: whether all pixels get the same number in any case, and auxiliary features are those of
                the samples wherever a few samples are known: deciding takes an eighth of the time of tracing
                a disc at one sample per pixel, and features of their own as long as a path.

        Raises:
            ValueError: the underlay, if it is used, belongs to another camera.
        """
        if not len(request.region.pixels):
            return _dark(request.region.pixels)
        if quick or request.spp < _ADAPTIVE_FROM:
            underlay = None
        checked = None if underlay is None else underlay_of(request.camera, underlay)
        if self._history is None:
            return self._alone(request, checked)
        if quick and features_along(request.spp):
            return self._quickly(request, self._history)
        known = self.known(request)
        sequence = self._sequence(request.camera, request.region.pixels, request.seed)
        if checked is not None:
            new = self._adaptive(request, known, sequence, checked)
        elif quick:
            new = self._traced(request.camera, _without_light(known), _even(request), request.seed, sequence)
        else:
            new = self._filled(request, known, sequence)
        self._history.remember(new)
        return merged(known, new)

    def trace_each(
        self, camera: Camera, pixels: NDArray[np.uint32], counts: NDArray[np.int64], seed: int
    ) -> Samples:
        """Samples of (D,) pixels, `counts` (D,) in each, at least 1; earlier frames are ignored."""
        if not len(pixels):
            return _dark(pixels)
        spp, positions = _one_for_all(counts), pixel_positions(mi.UInt32(pixels), camera.width)
        return _sampled(pixels, spp, self._tracer.trace(camera, positions, spp, seed))

    def known(self, request: DiscRequest) -> Samples:
        """What is known of the disc before any radiance is traced: auxiliary features and the history."""
        camera, pixels, seed = request.camera, request.region.pixels, request.seed
        spp = auxiliary_spp(request.spp)
        if self._history is None:
            return self._seen(camera, pixels, spp, self._sequence(camera, pixels, seed))
        spp = max(spp, _AUXILIARY_SPP_WITH_HISTORY)
        self._see(request, spp, spp, self._history)
        return self._history.recall(pixels)

    def _quickly(self, request: DiscRequest, history: History) -> Samples:
        """The same number of new samples for every pixel; their auxiliary features join the known ones.

        After a saccade and where something appears, a few sample positions more than those are seen at once.
        """
        camera, pixels, spp, seed = request.camera, request.region.pixels, request.spp, request.seed
        drawn, pattern = history.sampled(camera, pixels, seed)
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        traced = self._tracer.trace(camera, positions, spp, seed, _one_for_all(drawn), pattern, features=True)
        assert traced.features is not None
        new = _showing(_sampled(pixels, spp, traced), traced.features)
        history.see(camera, new, spp, seed)
        history.remember(new)
        self._see(request, auxiliary_spp(spp), max(auxiliary_spp(spp) - spp, 1), history)
        return history.recall(pixels)

    def _see(self, request: DiscRequest, wanted: int, spp: int, history: History) -> None:
        """Adds auxiliary features where they are means over fewer than `wanted` sample positions."""
        camera, seed = request.camera, request.seed
        unseen = history.unseen(camera, request.region.pixels, wanted)
        seen = self._seen(camera, unseen, spp, self._sequence(camera, unseen, seed))
        history.see(camera, seen, spp, seed)

    def _alone(self, request: DiscRequest, underlay: Underlay | None) -> Samples:
        """Samples without a history; with the splats under the disc, they go where they help most."""
        if not request.auxiliary:
            return self.trace_each(request.camera, request.region.pixels, _even(request), request.seed)
        if underlay is None:
            return self._with_features(request)
        if features_along(request.spp):
            return self._adaptive_with_features(request, underlay)
        known = self.known(request)
        return merged(known, self._adaptive(request, known, _Sequence(0, request.seed), underlay))

    def _adaptive(
        self, request: DiscRequest, known: Samples, sequence: _Sequence, underlay: Underlay
    ) -> Samples:
        """New samples: a few everywhere, the others where these disagree with the splats."""
        even = np.ones(len(request.region.pixels), dtype=np.float32)
        have = self._have(request.region, known)
        counts = allotted(even, have, _first_spp(request.spp) * len(even), request.seed)
        new = self._traced(request.camera, _without_light(known), counts, request.seed, sequence)
        counts = _second_counts(request, merged(known, new), have + new.count, underlay)
        return self._traced(request.camera, new, counts, request.seed + _SECOND_STREAM, sequence)

    def _adaptive_with_features(self, request: DiscRequest, underlay: Underlay) -> Samples:
        """As `_adaptive`, without a history; auxiliary features are those of the samples."""
        camera, pixels, seed = request.camera, request.region.pixels, request.seed
        spp = _first_spp(request.spp)
        first = self._with_features(request, spp)
        counts = _second_counts(request, first, first.count, underlay)
        chosen = np.flatnonzero(counts)
        counts = counts[chosen]
        positions = pixel_positions(mi.UInt32(pixels[chosen]), camera.width)
        traced = self._tracer.trace(
            camera, positions, _one_for_all(counts), seed + _SECOND_STREAM, spp, seed, features=True
        )
        assert traced.features is not None
        second = _showing(_sampled(pixels[chosen], counts, traced), traced.features)
        share = second.count / (auxiliary_spp(spp) + second.count)
        part = averaged_features(taken(first, chosen), second, share)
        return put(first, chosen, merged(part, second))

    def _with_features(self, request: DiscRequest, spp: int | None = None) -> Samples:
        """Samples with their auxiliary features, `spp` instead of the request's in each pixel."""
        pixels, camera, spp = request.region.pixels, request.camera, spp or request.spp
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        traced, features = self._tracer.trace_with_features(camera, positions, spp, request.seed)
        return _showing(_sampled(pixels, spp, traced), features)

    def _filled(self, request: DiscRequest, known: Samples, sequence: _Sequence) -> Samples:
        """New samples, more of them where fewer are known."""
        region = request.region
        even = np.ones(len(region.pixels), dtype=np.float32)
        new = _without_light(known)
        have = self._have(region, known) + new.count
        counts = allotted(even, have, request.spp * len(region.pixels), request.seed)
        return self._traced(request.camera, new, counts, request.seed, sequence)

    def _sequence(self, camera: Camera, pixels: NDArray[np.uint32], seed: int) -> _Sequence:
        if self._history is None:
            return _Sequence(0, seed)
        return _Sequence(*self._history.sampled(camera, pixels, seed))

    def _seen(self, camera: Camera, pixels: NDArray[np.uint32], spp: int, sequence: _Sequence) -> Samples:
        """Pixels with auxiliary features but without radiance."""
        if not len(pixels):
            return _dark(pixels)
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        seen = self._tracer.auxiliary(camera, positions, spp, sequence.pattern, sequence.taken)
        return _showing(_dark(pixels), seen)

    def _traced(
        self, camera: Camera, known: Samples, counts: NDArray[np.int64], seed: int, sequence: _Sequence
    ) -> Samples:
        """The pixels with `counts` further samples each, placed in the gaps between earlier ones."""
        chosen = np.flatnonzero(counts)
        drawn = (sequence.taken + known.count.astype(np.int64))[chosen]
        counts = counts[chosen]
        positions = pixel_positions(mi.UInt32(known.pixels[chosen]), camera.width)
        numbers = _one_for_all(counts), seed, _one_for_all(drawn)
        traced = self._tracer.trace(camera, positions, *numbers, sequence.pattern)
        count, radiance, squares = map(np.zeros_like, (known.count, known.radiance, known.squares))
        count[chosen] = counts
        radiance[chosen], squares[chosen] = interleaved(traced.radiance), interleaved(traced.squares)
        return merged(known, replace(known, count=count, radiance=radiance, squares=squares))

    def _have(self, region: FoveaRegion, known: Samples) -> NDArray[np.float32]:
        """(D,) samples per pixel in the neighbourhood of each pixel.

        Reprojected samples fall on pixels at random. Filling every gap among them would take several samples
        of one pixel at once, which blur when they are reprojected in turn. Gaps are therefore filled only
        where a whole neighbourhood lacks samples.
        """
        if self._history is None:
            return known.count
        rectangle = region.rectangle
        nothing = np.zeros((*rectangle.shape, 1), dtype=np.float32)
        counted = rectangle.scattered(nothing, np.stack([known.count], axis=1))[..., 0]
        inside = rectangle.scattered(nothing, np.ones((len(known.count), 1), dtype=np.float32))[..., 0]
        mean = uniform_filter(counted, _WINDOW) / np.maximum(uniform_filter(inside, _WINDOW), 1e-3)
        return np.where(known.count < 1, 0, np.maximum(rectangle.gathered(mean[..., None])[:, 0], 1))


@dataclass(frozen=True)
class _Sequence:
    """Where the next samples lie in their pixels.

    Attributes:
        taken: samples already drawn, (D,) or one number for all pixels.
        pattern: seed of the sampling pattern.
    """

    taken: int | NDArray[np.int64]
    pattern: int


def _even(request: DiscRequest) -> NDArray[np.int64]:
    """(D,) the same number of samples for each pixel."""
    return np.full(len(request.region.pixels), request.spp, dtype=np.int64)


def _first_spp(spp: int) -> int:
    """Samples per pixel that are traced everywhere before the others go where they help most."""
    return max(_FEWEST_FIRST, int(_FIRST_SHARE * spp))


def _second_counts(
    request: DiscRequest, known: Samples, have: NDArray[np.float32], underlay: Underlay
) -> NDArray[np.int64]:
    """(D,) samples that go where what is known disagrees with the splats.

    Args:
        request: of all samples.
        known: of the disc's pixels.
        have: (D,) samples around each pixel.
        underlay: the splats.
    """
    region = request.region
    # Where samples go needs no fine detail: the quicker denoiser takes a fifth of the time.
    parents = parents_of(region, known, underlay, quick=True)
    differs = disagreement(parents.denoised, parents.splat)
    worth = region.rectangle.gathered(differs[..., None])[:, 0]
    left = (request.spp - _first_spp(request.spp)) * len(region.pixels)
    # The second samples must not repeat the random numbers of the first ones.
    return allotted(worth, have, left, request.seed + _SECOND_STREAM)


def _one_for_all(numbers: NDArray[np.int64]) -> int | NDArray[np.int64]:
    """A single number if all are equal, which saves the tracer an array."""
    return int(numbers[0]) if (numbers == numbers[0]).all() else numbers


def _without_light(samples: Samples) -> Samples:
    """The same pixels without any samples of radiance."""
    dark = np.zeros_like(samples.radiance)
    return replace(samples, count=dark[:, 0], radiance=dark, squares=dark)


def _dark(pixels: NDArray[np.uint32]) -> Samples:
    """Pixels about which nothing is known."""
    triple, gloss = np.zeros((len(pixels), 3), dtype=np.float32), np.zeros(len(pixels), dtype=np.uint8)
    mover = gloss.astype(np.uint16)
    return Samples(pixels, triple[:, 0], triple, triple, triple, triple, triple, gloss, mover)


def _sampled(pixels: NDArray[np.uint32], counts: int | NDArray[np.int64], traced: Traced) -> Samples:
    """What was traced of (D,) pixels, `counts` samples in each."""
    return replace(
        _dark(pixels),
        count=np.full(len(pixels), counts, dtype=np.float32),
        radiance=interleaved(traced.radiance),
        squares=interleaved(traced.squares),
    )


def _showing(samples: Samples, seen: AuxiliaryFeatures) -> Samples:
    """The samples with auxiliary features of the same pixels."""
    return replace(
        samples,
        albedo=interleaved(seen.albedo),
        normal=interleaved(seen.normal),
        position=interleaved(seen.position),
        gloss=seen.gloss.numpy().astype(np.uint8),
        mover=samples.mover if seen.mover is None else seen.mover.numpy().astype(np.uint16),
    )
