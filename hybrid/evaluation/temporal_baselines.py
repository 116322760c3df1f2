"""Temporal baselines of one path per pixel that know what the hybrid knows: TAA and SVGF.

Temporal antialiasing (TAA) accumulates colours where they were seen in the last frame (Karis, High Quality
Temporal Supersampling, 2014), as far as those around a pixel allow (variance clipping: Salvi, An Excursion in
Temporal Supersampling, 2016). Spatiotemporal variance-guided filtering (SVGF; Schied et al. 2017) accumulates
illumination without albedo and its moments, tells noise from shadows by these, and filters it by an à-trous
wavelet; TAA follows, as there. Parameters are those of the papers.

Images are float32 tensors (C, H, W) of linear radiance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from compose.camera.camera import Camera
from compose.image.colour import LUMINANCE_WEIGHTS, Image
from pathtrace.trace.film import FilmPositions, frame_positions, interleaved
from pathtrace.trace.tracer import Tracer

# Frames after which the offsets within pixels repeat, in bases 2 and 3 of Halton's sequence.
_OFFSETS = 16
# TAA: least share of the new frame, and standard deviations around a pixel that its history may have.
_TAA_SHARE, _TAA_DEVIATIONS = 0.1, 1.0
# RGB to luma and chroma (YCoCg).
_YCOCG = ((0.25, 0.5, 0.25), (0.5, 0.0, -0.5), (-0.25, 0.5, -0.25))
# Tone-mapped colours stay below 1, from where radiance is infinite.
_MOST_TONE = 0.9999
# SVGF: least share of the new frame, frames from which moments over time are trusted, and levels.
_SVGF_SHARE, _TRUSTED, _LEVELS = 0.2, 4, 5
# Edge-stopping functions: sigma of depth, of normals and of luminance.
_SIGMA_DEPTH, _SIGMA_NORMAL, _SIGMA_LUMINANCE = 1.0, 128.0, 4.0
# Reach of the estimate of variance where there is no history.
_REACH = 3
# Rounding of depths, relative: without it, nothing is in the plane of a wall that is seen head-on.
_ROUNDING = 1e-3
# What counts as the same surface in the last frame: steps of depth per pixel, relative depth, and cosine.
_STEPS, _NEAR, _COSINE = 2.0, 0.01, 0.9
# Albedo of which illumination is taken to be, at least; what has none at all is not divided.
_LEAST_ALBEDO = 0.01
_KERNEL = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)


@dataclass(frozen=True)
class TracedFrame:
    """One path per pixel and what it sees first, all at the same offset within their pixels.

    Attributes:
        camera: the view.
        radiance, albedo, normal: (3, H, W).
        position: (H * W, 3) float64 in the world, apparent where mirrors are.
        depth: (1, H, W) of the position, along the view axis.
    """

    camera: Camera
    radiance: Tensor
    albedo: Tensor
    normal: Tensor
    position: NDArray[np.float64]
    depth: Tensor

    @staticmethod
    def of(tracer: Tracer, camera: Camera, number: int, seed: int) -> TracedFrame:
        """The frame of a number in a sequence; same seed and number, same frame."""
        across, down = (_halton(number % _OFFSETS + 1, base) for base in (2, 3))
        pixels = frame_positions(camera)
        # Boxes without an extent: all of a frame's paths start at the same offset, as a rasterizer's.
        positions = FilmPositions(
            pixels.x + dr.opaque(mi.Float, across), pixels.y + dr.opaque(mi.Float, down), 0.0, 0.0
        )
        traced = tracer.trace(camera, positions, 1, seed, features=True)
        seen = traced.features
        assert seen is not None, "features were asked for"
        position = interleaved(seen.position).astype(np.float64)
        depth = camera.project(position)[1].astype(np.float32)
        radiance, albedo, normal = (
            _planes(interleaved(of), camera) for of in (traced.radiance, seen.albedo, seen.normal)
        )
        return TracedFrame(camera, radiance, albedo, normal, position, _planes(depth, camera))

    def places_in(self, last: Camera) -> tuple[Tensor, Tensor]:
        """Where pixel centres were in the last view: (H, W, 2) in pixels, and (1, H, W) how deep."""
        with np.errstate(divide="ignore", invalid="ignore"):
            (now, _), (before, depth) = (view.project(self.position) for view in (self.camera, last))
        places = self.camera.pixel_centres() + before - now
        # What was behind the viewer was nowhere.
        places[~((depth > 0) & np.isfinite(places).all(axis=1))] = -1
        size = self.camera.height, self.camera.width
        found = torch.from_numpy(places.astype(np.float32)).reshape(*size, 2)
        return found, _planes(depth.astype(np.float32), self.camera)


class TemporalAntialiasing:
    """TAA of the frames of a sequence."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begins another sequence."""
        self._last: Camera | None = None
        self._history, self._frames = torch.empty(0), 0

    def frame(self, traced: TracedFrame) -> Image:
        """The next frame, (H, W, 3)."""
        return self.resolved(traced, traced.radiance)

    def resolved(self, traced: TracedFrame, image: Tensor) -> Image:
        """The next frame from an image (3, H, W) of what was traced."""
        tone = _tone_mapped(image)
        if self._last is not None and self._history.shape == tone.shape:
            places, _ = traced.places_in(self._last)
            share = max(_TAA_SHARE, 1 / (self._frames + 1))
            tone = accumulated(tone, self._history, places, share)
        self._last, self._history = traced.camera, tone
        self._frames += 1
        return _image(_linear(tone))


def accumulated(tone: Tensor, history: Tensor, places: Tensor, share: float) -> Tensor:
    """A share of the new colours (3, H, W), the rest history from places (H, W, 2) in pixels, clipped.

    Outside the last frame there is no history.
    """
    height, width = tone.shape[1:]
    sides = torch.tensor([width, height], dtype=torch.float32)
    grid = (places / sides * 2 - 1)[None]
    known = functional.grid_sample(
        history[None], grid, "bicubic", padding_mode="border", align_corners=False
    )[0]
    matrix = torch.tensor(_YCOCG)
    new, old = (torch.einsum("ij,jhw->ihw", matrix, of) for of in (tone, known))
    around = functional.pad(new[None], (1, 1, 1, 1), mode="replicate")
    mean, square = (functional.avg_pool2d(of, 3, 1)[0] for of in (around, around**2))
    half = _TAA_DEVIATIONS * (square - mean**2).clamp(min=0).sqrt()
    # Towards the mean until it is within the box.
    away = ((old - mean).abs() / half.clamp(min=1e-8)).amax(dim=0).clamp(min=1)
    old = mean + (old - mean) / away
    within = ((places >= 0) & (places <= sides)).all(dim=2)
    mixed = torch.where(within, old + share * (new - old), new)
    return torch.einsum("ij,jhw->ihw", torch.linalg.inv(matrix), mixed).clamp(0, _MOST_TONE)


@dataclass(frozen=True)
class Guides:
    """What edge-stopping functions compare: depth (1, H, W), its gradient (2, H, W), normal (3, H, W)."""

    depth: Tensor
    gradient: Tensor
    normal: Tensor

    @staticmethod
    def of(depth: Tensor, normal: Tensor) -> Guides:
        """With the smaller one of the differences to either side: the other one may cross an edge."""
        slopes = []
        for axis in (2, 1):
            if depth.shape[axis] == 1:
                slopes.append(torch.zeros_like(depth))
                continue
            steps = depth.diff(dim=axis)
            # At the border of the frame, there is one side only.
            before = torch.cat([steps.narrow(axis, 0, 1), steps], dim=axis)
            after = torch.cat([steps, steps.narrow(axis, steps.shape[axis] - 1, 1)], dim=axis)
            slopes.append(torch.where(before.abs() < after.abs(), before, after))
        return Guides(depth, torch.cat(slopes), normal)

    def weights(self, reach: int, step: int = 1) -> Iterator[tuple[int, int, Tensor]]:
        """Row and column of each pixel of a square around a pixel, `step` apart, and its weight (1, H, W).

        They are w_z w_n of SVGF (equations 3 and 4); outside the frame 0.
        """
        pad = reach * step
        depths = functional.pad(self.depth[None], (pad,) * 4, mode="replicate")[0]
        normals = functional.pad(self.normal, (pad,) * 4)
        for row in range(-pad, pad + 1, step):
            for column in range(-pad, pad + 1, step):
                if row == column == 0:
                    yield 0, 0, torch.ones_like(self.depth)
                    continue
                slope = (self.gradient[:1] * column + self.gradient[1:] * row).abs()
                scale = _SIGMA_DEPTH * slope + _ROUNDING * self.depth
                apart = (self.depth - shifted(depths, pad, row, column)).abs() / scale
                cosine = (self.normal * shifted(normals, pad, row, column)).sum(dim=0, keepdim=True)
                yield row, column, torch.exp(-apart) * cosine.clamp(0, 1) ** _SIGMA_NORMAL


def shifted(padded: Tensor, pad: int, row: int, column: int) -> Tensor:
    """What lies by rows and columns beside each pixel (C, H, W) of an image that was padded."""
    height, width = padded.shape[1] - 2 * pad, padded.shape[2] - 2 * pad
    return padded[:, pad + row : pad + row + height, pad + column : pad + column + width]


class Svgf:
    """SVGF of the frames of a sequence."""

    def __init__(self) -> None:
        self._antialiasing = TemporalAntialiasing()
        self.forget()

    def forget(self) -> None:
        """Begins another sequence."""
        self._antialiasing.forget()
        self._last: tuple[Camera, Guides] | None = None
        # Illumination, two moments of its luminance, and number of frames: (6, H, W).
        self._history = torch.empty(0)

    def frame(self, traced: TracedFrame) -> Image:
        """The next frame, (H, W, 3)."""
        guides = Guides.of(traced.depth, traced.normal)
        # What emits or mirrors has no albedo, and illumination of 1 / 0.01 would leak out of it.
        dark = traced.albedo.amax(dim=0, keepdim=True) < _LEAST_ALBEDO
        albedo = torch.where(dark, 1.0, traced.albedo.clamp(min=_LEAST_ALBEDO))
        illumination = traced.radiance / albedo
        light = _luminance(illumination)
        now = torch.cat([illumination, light, light**2])
        history = torch.zeros(6, *light.shape[1:])
        if self._last is not None and self._history.shape == history.shape:
            camera, before = self._last
            history = reprojected(self._history, before, guides, *traced.places_in(camera))
        frames = history[5:] + 1
        share = torch.clamp(1 / frames, min=_SVGF_SHARE)
        known = history[:5] + share * (now - history[:5])
        variance = variance_of(known[3:], frames, guides)
        illumination = known[:3]
        for level in range(_LEVELS):
            illumination, variance = wavelet(illumination, variance, guides, 1 << level)
            if level == 0:
                # The first level's is the history of the next frame.
                self._history = torch.cat([illumination, known[3:], frames])
        self._last = traced.camera, guides
        return self._antialiasing.resolved(traced, illumination * albedo)


def reprojected(history: Tensor, before: Guides, now: Guides, places: Tensor, depth: Tensor) -> Tensor:
    """History (C, H, W) at places (H, W, 2) of the last frame, from those of four pixels on the same surface.

    Depth (1, H, W) is that which the surfaces of now had there. Where none is the same, it is 0.
    """
    height, width = history.shape[1:]
    first = torch.floor(places - 0.5)
    share = places - 0.5 - first
    total, found = torch.zeros_like(depth), torch.zeros_like(history)
    allowed = _STEPS * now.gradient.abs().amax(dim=0, keepdim=True) + _NEAR * depth
    for down in range(2):
        for right in range(2):
            column, row = (first[..., 0] + right).long(), (first[..., 1] + down).long()
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            row, column = row.clamp(0, height - 1), column.clamp(0, width - 1)
            same = inside & ((before.depth[:, row, column] - depth).abs() <= allowed)
            cosine = (before.normal[:, row, column] * now.normal).sum(dim=0)
            # Where there is no normal on either side, both are the sky.
            sky = (before.normal[:, row, column].abs() + now.normal.abs()).sum(dim=0) == 0
            same &= (cosine >= _COSINE) | sky
            across, along = share[..., 0], share[..., 1]
            weight = (across if right else 1 - across) * (along if down else 1 - along) * same
            total += weight
            found += weight * history[:, row, column]
    return torch.where(total > _NEAR, found / total.clamp(min=_NEAR), 0)


def variance_of(moments: Tensor, frames: Tensor, guides: Guides) -> Tensor:
    """Variance (1, H, W) of luminance from its moments (2, H, W) over time, or around a young pixel.

    The latter are filtered over 7 x 7 pixels by depth and normal, and count more the younger it is.
    """
    young = frames < _TRUSTED
    if young.any():
        padded = functional.pad(moments[None], (_REACH,) * 4, mode="replicate")[0]
        total, found = torch.zeros_like(frames), torch.zeros_like(moments)
        for row, column, weight in guides.weights(_REACH):
            total += weight
            found += weight * shifted(padded, _REACH, row, column)
        moments = torch.where(young, found / total, moments)
    variance = (moments[1:] - moments[:1] ** 2).clamp(min=0)
    return torch.where(young, variance * _TRUSTED / frames, variance)


def wavelet(illumination: Tensor, variance: Tensor, guides: Guides, step: int) -> tuple[Tensor, Tensor]:
    """One level of the à-trous wavelet, and the variance (1, H, W) that it leaves (equations 1, 2 and 5)."""
    pad = 2 * step
    light = _luminance(illumination)
    smooth = functional.pad(variance[None], (1, 1, 1, 1), mode="replicate")
    binomial = torch.tensor([[1.0, 2, 1], [2, 4, 2], [1, 2, 1]])[None, None] / 16
    scale = _SIGMA_LUMINANCE * functional.conv2d(smooth, binomial)[0].clamp(min=0).sqrt() + 1e-10
    values = torch.cat([illumination, variance, light])
    padded = functional.pad(values[None], (pad,) * 4, mode="replicate")[0]
    total, sums, spread = torch.zeros_like(light), torch.zeros_like(illumination), torch.zeros_like(light)
    for row, column, weight in guides.weights(2, step):
        there = shifted(padded, pad, row, column)
        weight = weight * torch.exp(-(light - there[4:]).abs() / scale)
        weight = weight * (_KERNEL[row // step + 2] * _KERNEL[column // step + 2])
        total += weight
        sums += weight * there[:3]
        spread += weight**2 * there[3:4]
    return sums / total, spread / total**2


def _luminance(image: Tensor) -> Tensor:
    return (image * torch.tensor(LUMINANCE_WEIGHTS)[:, None, None]).sum(dim=0, keepdim=True)


def _tone_mapped(radiance: Tensor) -> Tensor:
    """Into 0..1 by the brightest channel, so that single bright paths do not outweigh all others (Karis)."""
    return radiance / (1 + radiance.amax(dim=0, keepdim=True))


def _linear(tone: Tensor) -> Tensor:
    return tone / (1 - tone.amax(dim=0, keepdim=True))


def _planes(values: NDArray[np.float32], camera: Camera) -> Tensor:
    """(C, H, W) planes of values (H * W, C) or (H * W,)."""
    image = torch.from_numpy(values).reshape(camera.height, camera.width, -1)
    return image.permute(2, 0, 1).contiguous()


def _image(planes: Tensor) -> Image:
    return np.ascontiguousarray(planes.permute(1, 2, 0).numpy())


def _halton(number: int, base: int) -> float:
    """The number's digits in a base, mirrored at the point: in 0..1."""
    found, share = 0.0, 1.0
    while number:
        share /= base
        number, digit = divmod(number, base)
        found += share * digit
    return found
