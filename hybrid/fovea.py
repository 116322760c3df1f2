"""The fovea of a frame: samples of the disc, denoised, fused with the splats under it, with their history."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from compose.blend import Image
from compose.foveation import FoveaPlan, mode_named
from compose.fusion import Fusion, Parents, fuse
from compose.history import History
from compose.rectangle import Rectangle
from compose.samples import Samples, merged
from compose.sampling import allotted, disagreement
from compose.view import Camera
from pathtrace.denoise import denoise, denoise_coarsely
from pathtrace.film import pixel_positions
from pathtrace.tracer import Tracer, guide_places

# With fewer samples per pixel the better network costs more than it is worth.
_FAST_BELOW = 3.0
# From so many samples per pixel on, a part of them, traced everywhere, tells where the others are needed.
_ADAPTIVE_FROM = 4
_FIRST_SHARE = 0.25
_FEWEST_FIRST = 2
_SECOND_STREAM = 0x5EED0000
# What a history makes of few samples a frame is worth better guides than those few would be.
_PLACES_IN_MOTION = 8
# Side of the window, in pixels, over which it is looked whether samples are missing.
_WINDOW = 5


@dataclass(frozen=True)
class Underlay:
    """The splats' picture under the disc.

    Attributes:
        camera: the view.
        radiance: (H, W, 3) of the whole frame; only the rectangle around the disc is looked at.
        enlargement: side of the pixels that the splats were trained on, in pixels of this picture.
    """

    camera: Camera
    radiance: Image
    enlargement: float


@dataclass(frozen=True)
class FoveaPicture:
    """The fovea and what it was made of, for the D pixels of a plan.

    Attributes:
        radiance: (D, 3) linear.
        samples: per pixel, with those of earlier frames.
        denoised: (D, 3), unless raw.
        weights: (D, 3) share of each parent (compose.fusion.PARENTS), only if fused.
        excluded: pixels in which a parent was left out because it was not finite or negative.
    """

    radiance: Image
    samples: Samples
    denoised: Image | None = None
    weights: Image | None = None
    excluded: int = 0


class Fovea:
    """Makes the foveas of one scene.

    Args:
        tracer: of the scene.
        mode: raw, what Mitsuba gives, unbiased; denoised, by OIDN; fused, with the splats as well.
        fusion: fitted to the scene and its splats; None fuses by statistics alone.
        remembers: whether samples of earlier frames count.

    Raises:
        UserError: there is no such mode.
    """

    def __init__(self, tracer: Tracer, mode: str, fusion: Fusion | None = None, remembers: bool = False):
        self.tracer, self.mode = tracer, mode_named(mode)
        self._fusion = fusion
        self._history = History() if remembers else None

    def trace(
        self, camera: Camera, plan: FoveaPlan, spp: int, seed: int, under: Underlay | None = None
    ) -> Samples:
        """Samples of the plan's pixels, together with what is remembered of them.

        Args:
            camera: the view.
            plan: the disc.
            spp: samples per pixel, on the mean over the disc.
            seed: same seed, same samples.
            under: the splats under the disc; with them, samples go where they help. Without, and where they
                are few, all pixels get the same number.
        """
        if not len(plan.pixels):
            return _dark(plan.pixels)
        sequence = self._sequence(camera, plan, seed)
        known = self.known(camera, plan, spp, seed)
        new = _without_light(known)
        total = spp * len(plan.pixels)
        worth = np.ones(len(plan.pixels), dtype=np.float32)
        if under is not None and spp >= _ADAPTIVE_FROM:
            # A few everywhere, then more where they disagree with the splats.
            first = max(_FEWEST_FIRST, int(_FIRST_SHARE * spp)) * len(plan.pixels)
            counts = allotted(worth, self._have(plan, known), first, seed)
            new = self._traced(camera, new, counts, seed, sequence)
            parents = _parents(plan, merged(known, new), _checked(camera, under))
            worth = plan.rectangle.taken(disagreement(parents.denoised, parents.splat)[..., None])[:, 0]
            # Another stream of random numbers than that of the first ones.
            total, seed = total - first, seed + _SECOND_STREAM
        counts = allotted(worth, self._have(plan, known) + new.count, total, seed)
        new = self._traced(camera, new, counts, seed, sequence)
        if self._history is not None:
            self._history.remember(new)
        return merged(known, new)

    def known(self, camera: Camera, plan: FoveaPlan, spp: int, seed: int) -> Samples:
        """What is known of pixels before anything but guides is traced; arguments as of `trace`."""
        places = guide_places(spp) if self._history is None else max(guide_places(spp), _PLACES_IN_MOTION)
        seen = self._seen(camera, plan, places, self._sequence(camera, plan, seed))
        return seen if self._history is None else self._history.recall(camera, seen, places, seed)

    def _sequence(self, camera: Camera, plan: FoveaPlan, seed: int) -> _Sequence:
        if self._history is None:
            return _Sequence(np.zeros(len(plan.pixels), dtype=np.int64), seed)
        return _Sequence(*self._history.taken(camera, plan.pixels, seed))

    def _seen(self, camera: Camera, plan: FoveaPlan, places: int, sequence: _Sequence) -> Samples:
        """The plan's pixels with their guides, without light."""
        if self.mode == "raw" and self._history is None:
            # Nobody would look at them.
            return _dark(plan.pixels)
        positions = pixel_positions(mi.UInt32(plan.pixels), camera.width)
        seen = self.tracer.guides(camera, positions, places, sequence.pattern, sequence.taken)
        return replace(
            _dark(plan.pixels),
            albedo=_triple(seen.albedo),
            normal=_triple(seen.normal),
            position=_triple(seen.place),
            gloss=seen.gloss.numpy().astype(np.uint8),
        )

    def _traced(
        self, camera: Camera, known: Samples, counts: NDArray[np.int64], seed: int, sequence: _Sequence
    ) -> Samples:
        """With so many more samples of each pixel, placed in them where earlier ones left gaps."""
        chosen = np.flatnonzero(counts)
        counts, pixels = counts[chosen], known.pixels[chosen]
        taken = sequence.taken[chosen] + known.count[chosen].astype(np.int64)
        spp = int(counts[0]) if (counts == counts[0]).all() else counts
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        traced = self.tracer.trace(camera, positions, spp, seed, taken, sequence.pattern)
        count = np.zeros_like(known.count)
        radiance, squares = np.zeros_like(known.radiance), np.zeros_like(known.squares)
        count[chosen], radiance[chosen], squares[chosen] = (
            counts,
            _triple(traced.radiance),
            _triple(traced.squares),
        )
        return merged(known, replace(known, count=count, radiance=radiance, squares=squares))

    def _have(self, plan: FoveaPlan, known: Samples) -> NDArray[np.float32]:
        """(D,) samples per pixel around each.

        Those that were carried along fall on pixels as chance will have it. Filling every gap among them
        would take several samples of a pixel at once, which blur where they are carried in their turn; only
        what lacks samples as a whole is to be filled.
        """
        if self._history is None:
            return known.count
        around = plan.rectangle
        nothing = np.zeros((*around.shape, 1), dtype=np.float32)
        counted = around.laid(nothing, np.stack([known.count], axis=1))[..., 0]
        inside = around.laid(nothing, np.ones((len(known.count), 1), dtype=np.float32))[..., 0]
        mean = uniform_filter(counted, _WINDOW) / np.maximum(uniform_filter(inside, _WINDOW), 1e-3)
        return np.where(known.count < 1, 0, np.maximum(around.taken(mean[..., None])[:, 0], 1))

    def picture(
        self, camera: Camera, plan: FoveaPlan, samples: Samples, around: Image, under: Underlay | None
    ) -> FoveaPicture:
        """The fovea that the samples give.

        Args:
            camera: the view.
            plan: the disc.
            samples: of its pixels.
            around: (H, W, 3) radiance that stands in for the corners of the rectangle around the disc.
            under: the splats under the disc, of the same view; only looked at if fused.

        Raises:
            ValueError: the splats' picture is missing, or of another camera or size.
        """
        if self.mode == "raw" or not len(plan.pixels):
            return FoveaPicture(samples.radiance, samples)
        rectangle = plan.rectangle
        taken = rectangle.taken
        if self.mode == "denoised":
            laid = _Laid.of(samples, rectangle.part_of(around), rectangle)
            denoised = taken(laid.denoised(coarse=False))
            return FoveaPicture(denoised, samples, denoised)
        parents = _parents(plan, samples, _checked(camera, under))
        fused = fuse(parents, self._fusion)
        return FoveaPicture(
            taken(fused.radiance), samples, taken(parents.denoised), taken(fused.weights), fused.excluded
        )


def _parents(plan: FoveaPlan, samples: Samples, under: Underlay) -> Parents:
    """All that is known of the rectangle around the disc."""
    rectangle = plan.rectangle
    splat = rectangle.part_of(under.radiance)
    laid = _Laid.of(samples, splat, rectangle)
    variance = rectangle.laid(np.full_like(splat, np.inf), samples.variance())
    guides = laid.albedo, laid.normal, laid.count
    return Parents(laid.radiance, variance, laid.denoised(coarse=True), splat, *guides, under.enlargement)


def denoised_for_fusion(radiance: Image, albedo: Image, normal: Image, spp: float) -> Image:
    """(H, W, 3) denoised as one parent of several: with few samples, not worth its full price."""
    if is_quick(spp):
        return denoise_coarsely(radiance, albedo, normal)
    return denoise(radiance, albedo, normal)


@dataclass(frozen=True)
class _Laid:
    """A disc's samples in the rectangle around it; outside of the disc, what is known of that.

    Attributes:
        radiance, albedo, normal: (h, w, 3).
        count: (h, w, 1).
    """

    radiance: Image
    albedo: Image
    normal: Image
    count: Image

    @staticmethod
    def of(samples: Samples, around: Image, rectangle: Rectangle) -> _Laid:
        laid = rectangle.laid
        return _Laid(
            laid(around, samples.radiance),
            # Outside the disc no guide was traced; the picture itself is the best one there is.
            laid(np.clip(around, 0, 1), samples.albedo),
            laid(np.zeros_like(around), samples.normal),
            laid(np.ones((*rectangle.shape, 1), dtype=np.float32), samples.count[:, None]),
        )

    def denoised(self, coarse: bool) -> Image:
        """(h, w, 3); coarse as one parent of several may be."""
        images, spp = (self.radiance, self.albedo, self.normal), float(self.count.mean())
        return denoised_for_fusion(*images, spp) if coarse else denoise(*images, is_quick(spp))


@dataclass(frozen=True)
class _Sequence:
    """Where samples go in their pixels: (D,) how many there are already, and the seed of the pattern."""

    taken: NDArray[np.int64]
    pattern: int


def _triple(channels: list[mi.Float]) -> NDArray[np.float32]:
    return np.stack([channel.numpy() for channel in channels], axis=1)


def is_quick(spp: float) -> bool:
    """Whether the quicker denoiser is the better deal at so many samples per pixel."""
    return spp < _FAST_BELOW


def _checked(camera: Camera, under: Underlay | None) -> Underlay:
    if under is None:
        raise ValueError("a fused fovea needs the splats' picture under the disc")
    size = under.radiance.shape[:2]
    if size != (camera.height, camera.width):
        raise ValueError(
            f"the splats' picture is {size[1]} x {size[0]}, the frame {camera.width} x {camera.height}"
        )
    if under.camera.key != camera.key:
        raise ValueError("the splats' picture is one of another camera")
    return under


def _without_light(samples: Samples) -> Samples:
    """The same pixels, as if no sample had been taken."""
    dark = np.zeros_like(samples.radiance)
    return replace(samples, count=dark[:, 0], radiance=dark, squares=dark)


def _dark(pixels: NDArray[np.uint32]) -> Samples:
    """Pixels of which nothing is known."""
    triple, gloss = np.zeros((len(pixels), 3), dtype=np.float32), np.zeros(len(pixels), dtype=np.uint8)
    return Samples(pixels, triple[:, 0], triple, triple, triple, triple, triple, gloss)
