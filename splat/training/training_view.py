"""Frames that Gaussians are trained on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from compose.camera.camera import Camera
from compose.camera.coordinate_systems import Place, place_around
from splat.model.points import Bits, Floats, Ints

# Pixels of a view, about, from which medians are found.
_SAMPLED = 4096
# Largest number of float16.
_LARGEST_HALF = float(np.finfo(np.float16).max)
# Degrees from the axis up to which pixels count as equally large.
_WIDE = 45.0
# In units of a place, 25,000 times the median distance of what is seen: seven such distances away, a viewer
# sees the sky moved by half a pixel of 1,920 over 60 degrees. Surfaces farther away are drawn there, too.
SKY_DISTANCE = 1e5
# Share of the median radiance of a frame below which nothing is drawn.
_DARK = 1e-3
# Share of dark pixels, among those that hit nothing, above which there is no sky, but a void.
_MOST_DARK = 0.8
# Pixels around those that see nothing at all that are not the sky: what is bright there belongs to an edge.
_EDGE = 2


@dataclass(frozen=True)
class TrainingView:
    """One frame to train on."""

    camera: Camera
    radiance: NDArray[np.floating]  # (H, W, 3) linear, float32 or float16
    # (H, W) float32 along the ray to the visible surface, or the one that a mirror shows; inf if none is hit
    distance: NDArray[np.float32]
    normal: NDArray[np.floating]  # (H, W, 3) in world space, of the same type, zero where it is unknown
    sky: float = np.inf  # distance of pixels that show the sky, and no surface; inf for a view of the world
    time: float = 0.0  # that the view shows, from 0 to 1
    # (H, W) int32, which instance that moves a pixel shows, -1 for none; None if nothing moves.
    instance: NDArray[np.int32] | None = None
    # Whether distances are guesses (`depth_estimates`), which training replaces by its own.
    guessed: bool = False

    @property
    def is_finite(self) -> bool:
        """Whether it can be learnt from: finite radiance and normals, distances that are numbers or inf."""
        finite = np.isfinite(self.radiance).all() and np.isfinite(self.normal).all()
        return bool(finite and (self.distance >= 0).all())

    def instances(self, pixels: Ints) -> NDArray[np.int32]:
        """(M,) instances that pixels show, row-major indices (M,); -1 for none."""
        if self.instance is None:
            return np.full(len(pixels), -1, dtype=np.int32)
        return self.instance.ravel()[pixels]

    @property
    def surface_pixels(self) -> Ints:
        """Row-major indices of the pixels that show a surface, or the sky where it has a place."""
        distance = self.distance.ravel()
        # A camera on a surface has no way to it along which anything could be placed.
        return np.flatnonzero(np.isfinite(distance) & (distance > 0))

    @property
    def sky_pixels(self) -> Ints:
        """Row-major indices of the pixels that show the sky; none in a view of the world."""
        distance = self.distance.ravel()
        return np.flatnonzero(np.isfinite(distance) & (distance >= self.sky))

    @property
    def some_surface_pixels(self) -> Ints:
        """An even part of the pixels that show a surface and not the sky, enough for a median."""
        seen = np.setdiff1d(self.surface_pixels, self.sky_pixels, assume_unique=True)
        return seen[:: max(1, len(seen) // _SAMPLED)]

    def points(self, pixels: Ints) -> Floats:
        """World positions (M, 3) of what pixels show, given by row-major indices (M,)."""
        distance = self.distance.ravel()[pixels].astype(np.float64)
        return self.camera.position + self.rays(pixels) * distance[:, None]

    def rays(self, pixels: Ints) -> Floats:
        """Unit directions (M, 3) in world space through the centres of pixels, row-major indices (M,)."""
        centres = np.stack([pixels % self.camera.width + 0.5, pixels // self.camera.width + 0.5], axis=1)
        return self.camera.rays(centres)

    def pixel_sizes(self, pixels: Ints) -> Floats:
        """(M,) size of pixels, at the distance of what they show, across the ray."""
        rays = self.rays(pixels)
        # A pixel's solid angle falls as the cube of the cosine. It matters where the field of view is wide.
        cosine = rays @ self.camera.world_to_camera[2, :3]
        narrowing = np.minimum(1, cosine / np.cos(np.radians(_WIDE))) ** 1.5
        return self.distance.ravel()[pixels].astype(np.float64) * narrowing / self.camera.fy


def in_half_precision(view: TrainingView) -> TrainingView:
    """The view with radiance and normals in half precision; finite radiance that exceeds it is clamped."""
    radiance = np.where(np.isinf(view.radiance), view.radiance, np.minimum(view.radiance, _LARGEST_HALF))
    return replace(view, radiance=radiance.astype(np.float16), normal=view.normal.astype(np.float16))


def shows_sky(radiance: NDArray[np.float32], distance: NDArray[np.float32]) -> Bits:
    """Mask (H, W) of the pixels that see light and hit nothing: their distance along the ray is inf."""
    missed = np.isinf(distance)
    if not missed.any():
        return missed
    brightness = radiance.max(axis=2)
    lit = brightness > 0
    dark = brightness <= (_DARK * np.median(brightness[lit]) if lit.any() else 0)
    if dark[missed].mean() > _MOST_DARK:
        return np.zeros_like(missed)
    nothing = binary_dilation(missed & dark, np.ones((2 * _EDGE + 1,) * 2))
    return np.asarray(missed & ~nothing)


def place_of(views: list[TrainingView]) -> Place:
    """The coordinates for Gaussians that are trained on views: amid what these see.

    ValueError if no view shows a surface.
    """
    seen = [(view, view.some_surface_pixels) for view in views]
    distance = np.concatenate([view.distance.ravel()[pixels] for view, pixels in seen])
    if not len(distance):
        raise ValueError("no frame shows a surface at a finite distance; turn the camera to one")
    points = np.concatenate([view.points(pixels) for view, pixels in seen])
    return place_around(points, float(np.median(distance)))


def placed(view: TrainingView, place: Place) -> TrainingView:
    """The view in the coordinates of a place, in which the sky has a place of its own."""
    distance = view.distance.astype(np.float64) / place.unit
    far = np.isfinite(distance) & (distance >= SKY_DISTANCE) | shows_sky(view.radiance, view.distance)
    normal = view.normal
    if far.any():
        rays = view.camera.rays(view.camera.pixel_centres()).reshape(normal.shape)
        normal = np.where(far[..., None], -rays, normal).astype(normal.dtype)
    camera, shown = place.camera(view.camera), np.where(far, SKY_DISTANCE, distance).astype(np.float32)
    return replace(view, camera=camera, distance=shown, normal=normal, sky=SKY_DISTANCE)


def pixel_footprint(views: list[TrainingView]) -> float:
    """Size of a pixel at the median distance of what the views see."""
    sizes = np.concatenate([view.pixel_sizes(view.some_surface_pixels) for view in views])
    # Without a surface, nothing is seeded that could be moved by it.
    return float(np.median(sizes)) if len(sizes) else 1 / views[0].camera.fy


def finest_focal(views: list[TrainingView]) -> float:
    """Vertical focal length in pixels of the views at the highest resolution."""
    return max(view.camera.fy for view in views)


def at_resolution(views: list[TrainingView], halvings: int) -> list[TrainingView]:
    """Views for a layer whose pixels are those of the finest views, doubled some times in width and height.

    Views that are coarser already stay as they are.
    """
    focal = finest_focal(views) / 2**halvings
    return [reduced(view, int(2 ** max(0, round(np.log2(view.camera.fy / focal))))) for view in views]


def reduced(view: TrainingView, factor: int) -> TrainingView:
    """A view at 1 / factor of its resolution, without the rows and columns after the last whole pixel."""
    if factor == 1:
        return view
    camera = view.camera
    height, width = camera.height // factor, camera.width // factor
    intrinsics = {name: getattr(camera, name) / factor for name in ("fx", "fy", "cx", "cy")}
    radiance = view.radiance[: height * factor, : width * factor]
    radiance = radiance.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    # A mean of distances would lie between a table's edge and the floor; the middle one lies on one of them.
    middle = np.s_[factor // 2 : height * factor : factor, factor // 2 : width * factor : factor]
    return replace(
        view,
        camera=replace(camera, width=width, height=height, **intrinsics),
        radiance=np.ascontiguousarray(radiance),
        distance=np.ascontiguousarray(view.distance[middle]),
        normal=np.ascontiguousarray(view.normal[middle]),
        instance=None if view.instance is None else np.ascontiguousarray(view.instance[middle]),
    )
