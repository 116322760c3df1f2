"""Traces the disc: distributes its samples, and reuses those of earlier frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.base.traced_samples import Counts, Moment
from compose.camera.camera import Camera
from compose.fovea.adaptive import allotted, disagreement, window_sum
from compose.fovea.disc import Disc
from compose.fovea.history import History
from compose.fovea.samples import Samples, averaged_features, merged, put, taken
from compose.fusion.combination import Fusion
from hybrid.base.compute_device import device_arrays
from hybrid.render.disc_images import Underlay, parents_of, smooth
from pathtrace.trace.film import pixel_positions
from pathtrace.trace.first_hit import AuxiliaryFeatures
from pathtrace.trace.tracer import Traced, Tracer, auxiliary_spp, features_along

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

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
    """Samples that a frame requires: `spp` per pixel on average, the same for the same seed."""

    camera: Camera
    disc: Disc
    spp: int
    seed: int
    auxiliary: bool = True


class _Sequence(NamedTuple):
    """Where the next samples lie in their pixels."""

    taken: mi.UInt32 | int  # samples already drawn, UInt (D,) or one number for all pixels
    pattern: int  # seed of the sampling pattern


class DiscTracer:
    """Traces the discs of one scene; with a history, samples of earlier frames are reused."""

    def __init__(self, tracer: Tracer, history: bool):
        self._tracer = tracer
        self._arrays = device_arrays()
        self._history = History(self._arrays) if history else None

    @property
    def has_history(self) -> bool:
        """Whether samples of earlier frames are reused."""
        return self._history is not None

    def forget(self) -> None:
        """Drops all samples of earlier frames."""
        if self._history is not None:
            self._history = History(self._arrays)

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
            self._history = History.restored(self._arrays, camera, state)

    def trace(self, request: DiscRequest, underlay: Underlay | None = None, quick: bool = False) -> Samples:
        """Samples of the disc's pixels, merged with what is known of them.

        Args:
            underlay: the splats under the disc; with them, samples go where they help most. Without them, and
                at low sample counts, all pixels get the same number. ValueError if it is used and belongs to
                another camera.
            quick: whether all pixels get the same number in any case, and auxiliary features are those of the
                samples wherever a few samples are known: deciding takes an eighth of the time of tracing a
                disc at one sample per pixel, and features of their own as long as a path.
        """
        if not request.disc.count:
            return Samples.none(self._arrays, request.disc.pixels)
        if quick or request.spp < _ADAPTIVE_FROM:
            underlay = None
        if underlay is not None and underlay.camera != request.camera:
            raise ValueError("the underlay belongs to another camera")
        if self._history is None:
            return self._alone(request, underlay)
        if quick and features_along(request.spp):
            return self._quickly(request, self._history)
        known = self.known(request)
        sequence = self._sequence(request.camera, request.disc.pixels, request.seed)
        if underlay is not None:
            new = self._adaptive(request, known, sequence, underlay)
        elif quick:
            new = self._added(request.camera, _without_light(known), request.spp, request.seed, sequence)
        else:
            new = self._even(request, known, request.spp, self._have(request.disc, known), sequence)
        self._history.remember(new)
        return merged(known, new)

    def trace_each(self, camera: Camera, pixels: UInt, counts: int | Counts, seed: int) -> Samples:
        """Samples of UInt (D,) pixels, at least 1 in each; earlier frames are ignored."""
        if not dr.width(pixels):
            return Samples.none(self._arrays, pixels)
        return self._traced(camera, pixels, counts, seed, _Sequence(0, seed))

    def known(self, request: DiscRequest) -> Samples:
        """What is known of the disc before any radiance is traced: auxiliary features and the history."""
        camera, pixels, spp = request.camera, request.disc.pixels, auxiliary_spp(request.spp)
        if self._history is None:
            return self._seen(camera, pixels, spp, request.seed)
        spp = max(spp, _AUXILIARY_SPP_WITH_HISTORY)
        self._see(request, spp, spp, self._history)
        return self._history.recall(pixels)

    def _quickly(self, request: DiscRequest, history: History) -> Samples:
        """The same number of new samples for every pixel; their auxiliary features join the known ones.

        After a saccade and where something appears, a few sample positions more than those are seen at once.
        """
        camera, pixels, spp, seed = request.camera, request.disc.pixels, request.spp, request.seed
        sequence = self._sequence(camera, pixels, seed)
        new = self._traced(camera, pixels, spp, seed, sequence, features=True)
        history.see(camera, new, spp, seed, request.disc)
        history.remember(new)
        self._see(request, auxiliary_spp(spp), max(auxiliary_spp(spp) - spp, 1), history)
        return history.recall(pixels)

    def _see(self, request: DiscRequest, wanted: int, spp: int, history: History) -> None:
        """Adds auxiliary features where they are means over fewer than `wanted` sample positions."""
        unseen = history.unseen(request.camera, request.disc.pixels, wanted)
        if dr.width(unseen):
            seen = self._seen(request.camera, unseen, spp, request.seed)
            history.see(request.camera, seen, spp, request.seed, request.disc)

    def _alone(self, request: DiscRequest, underlay: Underlay | None) -> Samples:
        """Samples without a history; with the splats under the disc, they go where they help most."""
        if not request.auxiliary:
            return self.trace_each(request.camera, request.disc.pixels, request.spp, request.seed)
        if underlay is None:
            return self._with_features(request, request.spp)
        if features_along(request.spp):
            return self._adaptive_with_features(request, underlay)
        known = self.known(request)
        return merged(known, self._adaptive(request, known, _Sequence(0, request.seed), underlay))

    def _adaptive(
        self, request: DiscRequest, known: Samples, sequence: _Sequence, underlay: Underlay
    ) -> Samples:
        """New samples: a few everywhere, the others where these disagree with the splats."""
        have = self._have(request.disc, known)
        new = self._even(request, known, _first_spp(request.spp), have, sequence)
        counts = _second_counts(request, merged(known, new), have + new.count, underlay)
        return self._added(request.camera, new, counts, request.seed + _SECOND_STREAM, sequence)

    def _adaptive_with_features(self, request: DiscRequest, underlay: Underlay) -> Samples:
        """Like `_adaptive`, without a history; auxiliary features are those of the samples."""
        camera, pixels, seed = request.camera, request.disc.pixels, request.seed
        spp = _first_spp(request.spp)
        first = self._with_features(request, spp)
        counts = _second_counts(request, first, first.count, underlay)
        chosen, counts = _chosen(self._arrays, counts, first.size)
        some, sequence = dr.gather(type(pixels), pixels, chosen), _Sequence(spp, seed)
        second = self._traced(camera, some, counts, seed + _SECOND_STREAM, sequence, features=True)
        share = second.count / (auxiliary_spp(spp) + second.count)
        part = averaged_features(taken(first, chosen), second, share)
        return put(first, chosen, merged(part, second))

    def _with_features(self, request: DiscRequest, spp: int) -> Samples:
        """Samples with their auxiliary features, `spp` in each pixel."""
        pixels, camera = request.disc.pixels, request.camera
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        traced, features = self._tracer.trace_with_features(camera, positions, spp, request.seed)
        return self._sampled(pixels, spp, replace(traced, features=features))

    def _even(
        self, request: DiscRequest, known: Samples, spp: int, have: Float, sequence: _Sequence
    ) -> Samples:
        """New samples, `spp` per pixel on average, more of them where there are fewer, Float (D,), so far."""
        even = dr.full(type(have), 1, known.size)
        counts = allotted(self._arrays, even, have, spp * known.size, request.seed)
        return self._added(request.camera, _without_light(known), counts, request.seed, sequence)

    def _sequence(self, camera: Camera, pixels: UInt, seed: int) -> _Sequence:
        if self._history is None:
            return _Sequence(0, seed)
        return _Sequence(*self._history.sampled(camera, pixels, seed))

    def _seen(self, camera: Camera, pixels: UInt, spp: int, seed: int) -> Samples:
        """Pixels, at least one, with auxiliary features but without radiance."""
        sequence = self._sequence(camera, pixels, seed)
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        seen = self._tracer.auxiliary(camera, positions, spp, sequence.pattern, sequence.taken)
        return _showing(Samples.none(self._arrays, pixels), seen)

    def _added(
        self, camera: Camera, known: Samples, counts: int | Counts, seed: int, sequence: _Sequence
    ) -> Samples:
        """The pixels with `counts` further samples each, placed in the gaps between earlier ones."""
        drawn = _Sequence(sequence.taken + self._arrays.plain.UInt(known.count), sequence.pattern)
        return merged(known, self._traced(camera, known.pixels, counts, seed, drawn))

    def _traced(
        self,
        camera: Camera,
        pixels: UInt,
        counts: int | Counts,
        seed: int,
        sequence: _Sequence,
        features: bool = False,
    ) -> Samples:
        """`counts` samples in each pixel, with their auxiliary features if those are wanted."""
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        traced = self._tracer.trace(
            camera, positions, counts, seed, sequence.taken, sequence.pattern, features
        )
        return self._sampled(pixels, counts, traced)

    def _have(self, disc: Disc, known: Samples) -> Float:
        """Float (D,), samples per pixel in the neighbourhood of each pixel.

        Reprojected samples fall on pixels at random. Filling every gap among them would take several samples
        of one pixel at once, which blur when they are reprojected in turn. Gaps are therefore filled only
        where a whole neighbourhood lacks samples.
        """
        if self._history is None:
            return known.count
        images = disc.images([known.count, dr.full(type(known.count), 1, known.size)], [0.0, 0.0])
        sums = [window_sum(disc.arrays, image, disc.shape, _WINDOW) for image in images]
        total, number = (dr.gather(type(of), of, disc.inside) for of in sums)
        return dr.select(known.count < 1, 0, dr.maximum(total / number, 1))

    def _sampled(self, pixels: UInt, counts: int | Counts, traced: Traced) -> Samples:
        """What was traced of (D,) pixels, `counts` samples in each."""
        Float = self._arrays.plain.Float
        each = dr.full(Float, counts, dr.width(pixels)) if isinstance(counts, int) else Float(counts.each)
        found = replace(
            Samples.none(self._arrays, pixels),
            count=each,
            radiance=_plain(traced.radiance),
            squares=_plain(traced.squares),
        )
        return found if traced.features is None else _showing(found, traced.features)


def _first_spp(spp: int) -> int:
    """Samples per pixel that are traced everywhere before the others go where they help most."""
    return max(_FEWEST_FIRST, int(_FIRST_SHARE * spp))


def _second_counts(request: DiscRequest, known: Samples, have: Float, underlay: Underlay) -> int | Counts:
    """The samples that go where what is known disagrees with the splats; `have` (D,) surround each pixel."""
    disc = request.disc
    # Where samples go needs no fine detail.
    parents = parents_of(disc, known, underlay, quick=True)
    fusion, everywhere = Fusion(parents), dr.arange(disc.arrays.plain.UInt, disc.shape[0] * disc.shape[1])
    estimate = fusion.estimate(smooth(fusion.ratio), everywhere)
    splat = parents.planes.at("splat", everywhere)
    differs = disagreement(disc.arrays, estimate, splat, disc.shape)
    worth = dr.gather(type(differs), differs, disc.inside)
    left = (request.spp - _first_spp(request.spp)) * disc.count
    # The second samples must not repeat the random numbers of the first ones.
    return allotted(disc.arrays, worth, have, left, request.seed + _SECOND_STREAM)


def _chosen(arrays: Arrays, counts: int | Counts, size: int) -> tuple[UInt, int | Counts]:
    """Indices (M,) of those of D pixels that get samples, and how many."""
    if isinstance(counts, int):
        return dr.arange(arrays.plain.UInt, size), counts
    chosen = arrays.plain.UInt(dr.compress(counts.each > 0))
    return chosen, replace(counts, each=dr.gather(type(counts.each), counts.each, chosen))


def _without_light(samples: Samples) -> Samples:
    """The same pixels without any samples of radiance."""
    dark = dr.zeros(type(samples.count), samples.size)
    return replace(samples, count=dark, radiance=[dark] * 3, squares=[dark] * 3)


def _plain(channels: list[mi.Float]) -> list[Float]:
    """Mitsuba's floats as arrays without derivatives."""
    # The stub does not know that their type changes.
    return [dr.detach(channel, preserve_type=False) for channel in channels]  # type: ignore[misc]


def _showing(samples: Samples, seen: AuxiliaryFeatures) -> Samples:
    """The samples with auxiliary features of the same pixels."""
    return replace(
        samples,
        albedo=_plain(seen.albedo),
        normal=_plain(seen.normal),
        position=_plain(seen.position),
        gloss=_plain([seen.gloss])[0],
        mover=samples.mover if seen.mover is None else _plain([seen.mover])[0],
    )
