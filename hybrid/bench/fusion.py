"""What a fused fovea is worth: against each of its parents, on views that nothing was fitted to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.mode import FoveaMode
from compose.fovea.region import Foveation
from compose.fovea.samples import Samples
from compose.image.colour import Image
from hybrid.frame.fovea import Fovea
from hybrid.frame.fusion import fusion_of
from hybrid.frame.periphery import Periphery
from hybrid.frame.settings import DEFAULTS
from hybrid.frame.underlay import Underlay
from hybrid.measure.metrics.flip import flip
from hybrid.measure.metrics.similarity import quality
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.runtime.device import device_arrays
from pathtrace.base.denoise import denoise
from pathtrace.dataset.frames import FrameSet
from pathtrace.scene.scene import Scene
from pathtrace.trace.tracer import Tracer
from splat.base.arrays import Arrays
from splat.model.forest import Forest


@dataclass(frozen=True)
class Crop:
    """The middle of a view, as a camera of its own.

    Attributes:
        scale: its resolution over that of the frame set.
        camera: sees the crop alone.
    """

    scale: int
    camera: Camera


def unfitted_views(frames: FrameSet) -> list[Camera]:
    """Cameras that neither the splats nor the fusion were fitted to.

    Raises:
        UserError: there is none.
    """
    cameras = [entry.camera for entry in frames.held_out if not entry.estimates]
    if not cameras:
        raise UserError(f"{frames.folder}: no view is kept from fitting; capture with --held-out 3 or more")
    return cameras


def crops(cameras: list[Camera], scales: tuple[int, ...], share: float) -> Iterator[Crop]:
    """The middle of each view, `share` of its width and height, at each resolution."""
    for camera in cameras:
        for scale in scales:
            large = camera.resized(camera.width * scale, camera.height * scale)
            width, height = (2 * round(share * side / 2) for side in (large.width, large.height))
            left, top = (large.width - width) / 2, (large.height - height) / 2
            yield Crop(scale, large.cropped(left, top, width, height))


def whole_underlay(periphery: Periphery, camera: Camera) -> Underlay:
    """The splats over the whole frame."""
    return Underlay(camera, periphery.whole(camera, DEFAULTS), periphery.enlargement(camera, DEFAULTS))


class Candidates:
    """All ways to make a fovea, with the same number of samples.

    Args:
        arrays, scene, forest: what is rendered.
    """

    def __init__(self, arrays: Arrays, scene: Scene, forest: Forest):
        self.tracer = Tracer(scene)
        self._periphery = Periphery(arrays, forest)
        self._fused = Fovea(self.tracer, fusion_of(forest))
        self._statistical = Fovea(self.tracer, None)

    def images(self, camera: Camera, spp: int, seed: int) -> dict[str, Image]:
        """(H, W, 3) by method: `fused` as in frames, the others with the same sample count everywhere."""
        underlay = whole_underlay(self._periphery, camera)
        # A disc that covers the frame.
        region = Foveation(Gaze(), 1000.0, 1000.0).region(camera.width, camera.height)

        def traced(under: Underlay | None) -> Samples:
            return self._fused.trace(FoveaMode.FUSED, camera, region, spp, seed, under)[1]

        def fused(fovea: Fovea, samples: Samples) -> Image:
            made = fovea.image(FoveaMode.FUSED, region, samples, underlay.radiance, underlay)
            return region.image_of(made.radiance)

        samples = traced(None)
        raw = region.image_of(samples.radiance)
        # Always the better denoiser: it is what fusion must beat.
        denoised = denoise(raw, region.image_of(samples.albedo), region.image_of(samples.normal))
        return {
            "splat": underlay.radiance,
            "raw": raw,
            "denoised": denoised,
            "mean": 0.5 * (denoised + underlay.radiance),
            "statistical": fused(self._statistical, samples),
            "fused, even": fused(self._fused, samples),
            "fused": fused(self._fused, traced(underlay)),
        }


def measured(image: Image, truth: Image) -> dict[str, float]:
    """All metrics that are installed."""
    found = quality(image, truth)
    difference = flip(image, truth)
    return found if difference is None else {**found, "flip": difference}


def means(rows: list[dict[str, float]]) -> dict[str, float]:
    """Mean of each metric over the rows that have it."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: float(np.mean([row[name] for row in rows if name in row])) for name in names}


@dataclass(frozen=True)
class FusionEffort:
    """How much is measured.

    Attributes:
        counts: samples per pixel.
        scales: resolutions of the crops over that of the frame set.
        seeds: runs of each.
        reference_spp: samples per pixel of the references.
    """

    counts: tuple[int, ...] = (1, 2, 4, 16, 64)
    scales: tuple[int, ...] = (1, 2)
    seeds: int = 2
    reference_spp: int = 1024


def bench_fusion(
    scene: Scene,
    frames: FrameSet,
    forest: Forest,
    effort: FusionEffort,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per resolution, sample count and method: means over views and seeds.

    Args:
        scene, forest: what is rendered.
        frames: that the forest was trained on; its unfitted views are measured.
        effort: how much is measured.
        progress: called with crops done and crops in total.
    """
    candidates = Candidates(device_arrays(), scene, forest)
    found: dict[tuple[int, int, str], list[dict[str, float]]] = {}
    limits: dict[int, list[float]] = {}
    places = list(crops(unfitted_views(frames), effort.scales, 0.4))
    for done, crop in enumerate(places):
        truth = reference(candidates.tracer, crop.camera, effort.reference_spp, REFERENCE_SEED)
        limits.setdefault(crop.scale, []).append(truth.psnr())
        for spp, seed in product(effort.counts, range(effort.seeds)):
            for method, image in candidates.images(crop.camera, spp, seed).items():
                found.setdefault((crop.scale, spp, method), []).append(measured(image, truth.radiance))
        progress(done + 1, len(places))
    return [
        {
            "scene": scene.name,
            "scale": scale,
            "spp": spp,
            "method": method,
            "views": len(places) // len(effort.scales),
            "seeds": effort.seeds,
            "reference_psnr": float(np.mean(limits[scale])),
            **means(rows),
        }
        for (scale, spp, method), rows in found.items()
    ]
