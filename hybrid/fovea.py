"""The fovea of a frame: samples of the disc, denoised, fused with the splats under it, with their history."""

from __future__ import annotations

from dataclasses import dataclass, fields

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.blend import Image
from compose.foveation import FoveaPlan, mode_named
from compose.fusion import Fusion, Parents, fuse
from compose.history import History
from compose.samples import Samples, merged
from compose.sampling import allotted, disagreement
from compose.view import Camera
from pathtrace.denoise import denoise, denoise_coarsely
from pathtrace.film import pixel_positions
from pathtrace.tracer import Traced, Tracer

# With fewer samples per pixel the better network costs more than it is worth.
_FAST_BELOW = 3.0
# From so many samples per pixel on, a part of them, traced everywhere, tells where the others are needed.
_ADAPTIVE_FROM = 4
_FIRST_SHARE = 0.25
_FEWEST_FIRST = 2
_SECOND_STREAM = 0x5EED0000


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
            return _no_samples()
        taken, pattern = np.zeros(len(plan.pixels), dtype=np.int64), seed
        if self._history is not None:
            taken, pattern = self._history.taken(camera, plan.pixels, seed)
        if under is None or spp < _ADAPTIVE_FROM:
            samples = self._traced(camera, plan.pixels, spp, seed, taken, pattern)
        else:
            under = _checked(camera, under)
            samples = self._traced_where_needed(camera, plan, spp, seed, taken, pattern, under)
        return samples if self._history is None else self._history.add(camera, samples, seed)

    def _traced(
        self,
        camera: Camera,
        pixels: NDArray[np.uint32],
        spp: int | NDArray[np.int64],
        seed: int,
        taken: NDArray[np.int64],
        pattern: int,
    ) -> Samples:
        """Samples of those pixels, placed in them where those that were taken before left gaps."""
        positions = pixel_positions(mi.UInt32(pixels), camera.width)
        traced = self.tracer.trace(camera, positions, spp, seed, guides=True, taken=taken, pattern=pattern)
        return samples_of(traced, pixels, spp)

    def _traced_where_needed(
        self,
        camera: Camera,
        plan: FoveaPlan,
        spp: int,
        seed: int,
        taken: NDArray[np.int64],
        pattern: int,
        under: Underlay,
    ) -> Samples:
        """A few samples everywhere, then more where they disagree with the splats."""
        around = Rectangle.around(plan)
        splat = around.part_of(under.radiance)
        fewer = max(_FEWEST_FIRST, int(_FIRST_SHARE * spp))
        first = self._traced(camera, plan.pixels, fewer, seed, taken, pattern)
        denoised = _Laid.of(first, splat, around).denoised(coarse=True)
        worth = around.taken(disagreement(denoised, splat)[..., None])[:, 0]
        counts = allotted(worth, (spp - fewer) * len(plan.pixels), seed)
        chosen = np.flatnonzero(counts)
        # Another stream of random numbers than that of the first ones.
        seed += _SECOND_STREAM
        taken = taken[chosen] + fewer
        more = self._traced(camera, plan.pixels[chosen], counts[chosen], seed, taken, pattern)
        return merged(first, _spread_out(more, chosen, first))

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
        rectangle = Rectangle.around(plan)
        if self.mode == "denoised":
            laid = _Laid.of(samples, rectangle.part_of(around), rectangle)
            denoised = rectangle.taken(laid.denoised(coarse=False))
            return FoveaPicture(denoised, samples, denoised)
        return self._fused(rectangle, samples, _checked(camera, under))

    def _fused(self, rectangle: Rectangle, samples: Samples, under: Underlay) -> FoveaPicture:
        splat = rectangle.part_of(under.radiance)
        laid = _Laid.of(samples, splat, rectangle)
        denoised = laid.denoised(coarse=True)
        variance = rectangle.laid(np.full_like(splat, np.inf), samples.variance())
        parents = Parents(
            *(laid.radiance, variance, denoised, splat, laid.albedo, laid.normal, laid.count),
            enlargement=under.enlargement,
        )
        fused = fuse(parents, self._fusion)
        taken = rectangle.taken
        return FoveaPicture(
            taken(fused.radiance), samples, taken(denoised), taken(fused.weights), fused.excluded
        )


def denoised_for_fusion(radiance: Image, albedo: Image, normal: Image, spp: float) -> Image:
    """(H, W, 3) denoised as one parent of several: with few samples, not worth its full price."""
    if is_quick(spp):
        return denoise_coarsely(radiance, albedo, normal)
    return denoise(radiance, albedo, normal)


@dataclass(frozen=True)
class Rectangle:
    """The rectangle around a disc.

    Attributes:
        box: its rows and columns.
        shape: how many they are.
        place: (D,) row-major index in it of each of the disc's pixels.
    """

    box: tuple[slice, slice]
    shape: tuple[int, int]
    place: NDArray[np.int64]

    @staticmethod
    def around(plan: FoveaPlan) -> Rectangle:
        """That of a plan; there must be a disc."""
        rows, columns = plan.box()
        pixels = plan.pixels.astype(np.int64)
        shape = rows.stop - rows.start, columns.stop - columns.start
        place = (pixels // plan.width - rows.start) * shape[1] + pixels % plan.width - columns.start
        return Rectangle((rows, columns), shape, place)

    def part_of(self, image: Image) -> Image:
        """(h, w, C) of an image of the frame."""
        return np.ascontiguousarray(image[self.box])

    def laid(self, ground: Image, values: NDArray[np.float32]) -> Image:
        """(h, w, C): the disc's values (D, C) on a ground (h, w, C)."""
        image = np.array(ground, dtype=np.float32, order="C")
        image.reshape(-1, image.shape[2])[self.place] = values
        return image

    def taken(self, image: Image) -> NDArray[np.float32]:
        """(D, C): the disc's values of an image (h, w, C)."""
        return np.take(image.reshape(-1, image.shape[2]), self.place, axis=0)


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


def samples_of(traced: Traced, pixels: NDArray[np.uint32], spp: int | NDArray[np.int64]) -> Samples:
    """What was traced with guides at those pixels, with so many samples each."""
    assert traced.gloss is not None
    triple = lambda channels: np.stack([c.numpy() for c in channels], axis=1)  # noqa: E731
    return Samples(
        pixels,
        np.broadcast_to(np.float32(spp), len(pixels)),
        triple(traced.radiance),
        triple(traced.squares),
        triple(traced.albedo),
        triple(traced.normal),
        triple(traced.place),
        traced.gloss.numpy().astype(np.uint8),
    )


def _spread_out(samples: Samples, chosen: NDArray[np.int64], like: Samples) -> Samples:
    """Samples of the chosen among other pixels as samples of all of them, none of those not chosen."""
    spread = {}
    for field in fields(Samples):
        values = np.zeros_like(getattr(like, field.name))
        values[chosen] = getattr(samples, field.name)
        spread[field.name] = values
    return Samples(**spread)


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


def _no_samples() -> Samples:
    triple = np.zeros((0, 3), dtype=np.float32)
    pixels, gloss = np.zeros(0, dtype=np.uint32), np.zeros(0, dtype=np.uint8)
    return Samples(pixels, triple[:, 0], triple, triple, triple, triple, triple, gloss)
