"""Where the samples of a disc go, and what is remembered of earlier ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from compose.camera.camera import Camera
from compose.fovea.adaptive import allotted, disagreement
from compose.fovea.history import History
from compose.fovea.region import FoveaRegion
from compose.fovea.samples import Samples, merged
from hybrid.frame.disc import Underlay, checked, parents_of
from pathtrace.trace.film import interleaved, pixel_positions
from pathtrace.trace.tracer import Tracer, auxiliary_spp

# From so many samples per pixel on, a part of them, traced everywhere, tells where the others are needed.
_ADAPTIVE_FROM = 4
_FIRST_SHARE = 0.25
_FEWEST_FIRST = 2
_SECOND_STREAM = 0x5EED0000
# What a history makes of few samples a frame is worth better auxiliary features than those few would be.
_PLACES_WITH_HISTORY = 8
# Side of the window, in pixels, over which it is looked whether samples are missing.
_WINDOW = 5


class DiscTracer:
    """Traces discs, sample by sample where they help.

    Args:
        tracer: of the scene.
        guided: whether anything will be made of albedo and normal.
        remembers: whether samples of earlier frames count.

    Attributes:
        history: those samples; None if they do not count.
    """

    def __init__(self, tracer: Tracer, with_auxiliary: bool, remembers: bool):
        self._tracer = tracer
        self._with_auxiliary = with_auxiliary or remembers
        self.history = History() if remembers else None

    def forget(self) -> None:
        """Nothing of earlier frames counts any more."""
        if self.history is not None:
            self.history = History()

    def trace(
        self,
        camera: Camera,
        region: FoveaRegion,
        spp: int,
        seed: int,
        underlay: Underlay | None = None,
        quick: bool = False,
    ) -> Samples:
        """Samples of the plan's pixels, together with what is remembered of them.

        Args:
            camera: the view.
            plan: the disc.
            spp: samples per pixel, on the mean over the disc.
            seed: same seed, same samples.
            under: the splats under the disc; with them, samples go where they help. Without, and where they
                are few, all pixels get the same number.
            hurried: whether all pixels get the same number whatever is known of them: to think about it takes
                an eighth of the time of tracing a disc with one sample per pixel.
        """
        if not len(region.pixels):
            return _dark(region.pixels)
        known = self.known(camera, region, spp, seed, quick)
        adaptive = underlay is not None and spp >= _ADAPTIVE_FROM and not quick
        if not adaptive and self.history is None:
            return self._afresh(camera, known, spp, seed)
        sequence = self._sequence(camera, region.pixels, seed)
        new = _without_light(known)
        total = spp * len(region.pixels)
        worth = np.ones(len(region.pixels), dtype=np.float32)
        if adaptive:
            # A few everywhere, then more where they disagree with the splats.
            first = max(_FEWEST_FIRST, int(_FIRST_SHARE * spp)) * len(region.pixels)
            counts = allotted(worth, self._have(region, known), first, seed)
            new = self._traced(camera, new, counts, seed, sequence)
            parents = parents_of(region, merged(known, new), checked(camera, underlay))
            differs = disagreement(parents.denoised, parents.splat)
            worth = region.rectangle.taken(differs[..., None])[:, 0]
            # Another stream of random numbers than that of the first ones.
            total, seed = total - first, seed + _SECOND_STREAM
        if quick:
            counts = np.full(len(region.pixels), spp, dtype=np.int64)
        else:
            counts = allotted(worth, self._have(region, known) + new.count, total, seed)
        new = self._traced(camera, new, counts, seed, sequence)
        if self.history is not None:
            self.history.remember(new)
        return merged(known, new)

    def trace_each(
        self, camera: Camera, pixels: NDArray[np.uint32], counts: NDArray[np.int64], seed: int
    ) -> Samples:
        """So many samples, (D,) at least 1, of each of (D,) pixels; nothing that is known helps them."""
        if not len(pixels):
            return _dark(pixels)
        return self._afresh(camera, _dark(pixels), _one_for_all(counts), seed)

    def known(self, camera: Camera, region: FoveaRegion, spp: int, seed: int, quick: bool = False) -> Samples:
        """What is known of pixels before anything but auxiliary features is traced; arguments as of `trace`."""
        pixels = region.pixels
        if self.history is None:
            return self._seen(camera, pixels, auxiliary_spp(spp), self._sequence(camera, pixels, seed))
        wanted = max(auxiliary_spp(spp), _PLACES_WITH_HISTORY)
        unseen = self.history.unseen(camera, pixels, wanted)
        # After a saccade all pixels want auxiliary features at once; in a hurry they get half of them in the next frame.
        places = auxiliary_spp(spp) if quick else wanted
        seen = self._seen(camera, unseen, places, self._sequence(camera, unseen, seed))
        return self.history.recall(camera, pixels, seen, places, seed)

    def _sequence(self, camera: Camera, pixels: NDArray[np.uint32], seed: int) -> _Sequence:
        if self.history is None:
            return _Sequence(0, seed)
        return _Sequence(*self.history.taken(camera, pixels, seed))

    def _seen(self, camera: Camera, pixels: NDArray[np.uint32], places: int, sequence: _Sequence) -> Samples:
        """Pixels with their auxiliary features, without light."""
        if not self._with_auxiliary or not len(pixels):
            return _dark(pixels)
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        seen = self._tracer.auxiliary(camera, positions, places, sequence.pattern, sequence.taken)
        return replace(
            _dark(pixels),
            albedo=interleaved(seen.albedo),
            normal=interleaved(seen.normal),
            position=interleaved(seen.place),
            gloss=seen.gloss.numpy().astype(np.uint8),
        )

    def _afresh(self, camera: Camera, known: Samples, spp: int | NDArray[np.int64], seed: int) -> Samples:
        """So many samples of each pixel, of whose light nothing is known yet."""
        positions = pixel_positions(mi.UInt32(known.pixels), camera.width)
        traced = self._tracer.trace(camera, positions, spp, seed)
        count = np.full(len(known.pixels), spp, dtype=np.float32)
        radiance, squares = interleaved(traced.radiance), interleaved(traced.squares)
        return replace(known, count=count, radiance=radiance, squares=squares)

    def _traced(
        self, camera: Camera, known: Samples, counts: NDArray[np.int64], seed: int, sequence: _Sequence
    ) -> Samples:
        """With so many more samples of each pixel, placed in them where earlier ones left gaps."""
        chosen = np.flatnonzero(counts)
        taken = (sequence.taken + known.count.astype(np.int64))[chosen]
        counts = counts[chosen]
        positions = pixel_positions(mi.UInt32(known.pixels[chosen]), camera.width)
        numbers = _one_for_all(counts), seed, _one_for_all(taken)
        traced = self._tracer.trace(camera, positions, *numbers, sequence.pattern)
        count, radiance, squares = map(np.zeros_like, (known.count, known.radiance, known.squares))
        count[chosen] = counts
        radiance[chosen], squares[chosen] = interleaved(traced.radiance), interleaved(traced.squares)
        return merged(known, replace(known, count=count, radiance=radiance, squares=squares))

    def _have(self, region: FoveaRegion, known: Samples) -> NDArray[np.float32]:
        """(D,) samples per pixel around each.

        Those that were carried along fall on pixels as chance will have it. Filling every gap among them
        would take several samples of a pixel at once, which blur where they are carried in their turn; only
        what lacks samples as a whole is to be filled.
        """
        if self.history is None:
            return known.count
        around = region.rectangle
        nothing = np.zeros((*around.shape, 1), dtype=np.float32)
        counted = around.scattered(nothing, np.stack([known.count], axis=1))[..., 0]
        inside = around.scattered(nothing, np.ones((len(known.count), 1), dtype=np.float32))[..., 0]
        mean = uniform_filter(counted, _WINDOW) / np.maximum(uniform_filter(inside, _WINDOW), 1e-3)
        return np.where(known.count < 1, 0, np.maximum(around.taken(mean[..., None])[:, 0], 1))


@dataclass(frozen=True)
class _Sequence:
    """Where samples go in their pixels: how many there are already, (D,) or one for all, and the seed of the
    pattern."""

    taken: int | NDArray[np.int64]
    pattern: int


def _one_for_all(numbers: NDArray[np.int64]) -> int | NDArray[np.int64]:
    """A single number where all are the same: the tracer needs no array for it."""
    return int(numbers[0]) if (numbers == numbers[0]).all() else numbers


def _without_light(samples: Samples) -> Samples:
    """The same pixels, as if no sample had been taken."""
    dark = np.zeros_like(samples.radiance)
    return replace(samples, count=dark[:, 0], radiance=dark, squares=dark)


def _dark(pixels: NDArray[np.uint32]) -> Samples:
    """Pixels of which nothing is known."""
    triple, gloss = np.zeros((len(pixels), 3), dtype=np.float32), np.zeros(len(pixels), dtype=np.uint8)
    return Samples(pixels, triple[:, 0], triple, triple, triple, triple, triple, gloss)
