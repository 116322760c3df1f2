"""All metrics of one picture, region by region."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.eye.acuity import geisler_perry
from compose.eye.display import Display
from compose.eye.gaze import Gaze, eccentricity
from compose.image.colour import Image
from hybrid.measure.metrics.flip import flip_map, hdr_flip_map
from hybrid.measure.metrics.fovvideovdp import jod
from hybrid.measure.metrics.lpips import lpips
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.metrics.ssim import ssim_map, valid_mean
from hybrid.measure.regions import Region

Map = NDArray[np.float32]
# Whether more is better.
METRICS = {
    "psnr": True,
    "ssim": True,
    "fssim": True,
    "flip": False,
    "hdr-flip": False,
    "lpips": False,
    "jod": True,
}
# Pixels that FLIP's filters reach at 67 pixels per degree.
_FLIP_REACH = 24


@dataclass(frozen=True)
class Viewer:
    """Who judges a frame: on what display, looking where."""

    display: Display
    gaze: Gaze


def checked_pair(image: Image, reference: Image, name: str) -> None:
    """Makes sure that two pictures can be compared.

    Raises:
        UserError: their sizes differ, or one has a pixel that is not finite.
    """
    if image.shape != reference.shape:
        size, other = (f"{picture.shape[1]} x {picture.shape[0]}" for picture in (image, reference))
        raise UserError(f"{name} is {size} pixels, its reference {other}: they cannot be compared")
    for picture, what in ((image, name), (reference, f"the reference of {name}")):
        bad = int(np.count_nonzero(~np.isfinite(picture).all(axis=-1)))
        if bad:
            raise UserError(f"{what} has {bad} pixels that are not finite: it cannot be compared")


def measured(
    image: Image,
    reference: Image,
    regions: dict[str, Region],
    viewer: Viewer,
    name: str = "the frame",
    whole_flip: Map | None = None,
) -> list[dict[str, float | str]]:
    """Rows of region, metric and value, for all metrics that are installed.

    No metric leaks over the border of a region: outside of it the picture is exchanged for the reference,
    and of the maps of SSIM and FLIP only the region's pixels count. LPIPS and FovVideoVDP, which give one
    number for a picture, see the foveal region as a crop; FovVideoVDP the others as the whole frame with the
    rest exchanged, LPIPS the whole alone. HDR-FLIP, which takes longer than all others together, looks at the
    foveal region alone; `fssim`, SSIM weighted by what the eye resolves at each pixel (Geisler and Perry
    1998, relative to the gaze), at the whole.

    Args:
        image, reference: (H, W, 3) linear radiance.
        regions: of the frame.
        viewer: for FovVideoVDP and the weights.
        name: of the picture, for messages.
        whole_flip: (H, W) the map of FLIP, where it is known already.

    Raises:
        UserError: the two cannot be compared.
    """
    checked_pair(image, reference, name)
    rows: list[dict[str, float | str]] = []
    for region in regions.values():
        alone = region.alone(image, reference)
        similarity = ssim_map(alone, reference)
        found: dict[str, float | None] = {
            "psnr": psnr(image, reference, region.mask),
            "ssim": valid_mean(similarity, region.mask.astype(np.float32)),
            "jod": _jod(alone, reference, region, viewer),
        }
        if region.name in ("whole", "foveal"):
            found["lpips"] = lpips(*_seen(alone, reference, region))
        if region.name == "whole" and whole_flip is not None:
            found["flip"] = float(whole_flip.mean())
        else:
            found["flip"] = _flip(alone, reference, region, flip_map)
        if region.name == "whole":
            found["fssim"] = valid_mean(similarity, acuity_weight(viewer, image.shape[:2]))
        if region.name == "foveal":
            found["hdr-flip"] = _flip(alone, reference, region, hdr_flip_map)
        rows += [
            {"region": region.name, "metric": metric, "value": float(found[metric])}  # type: ignore[arg-type]
            for metric in METRICS
            if found.get(metric) is not None
        ]
    return rows


def half_name(metric: str, number: int) -> str:
    """What a metric is called against the first or the second half of a reference's samples."""
    return f"{metric}, half {number}"


def foveal(image: Image, reference: Image, region: Region, viewer: Viewer) -> dict[str, float]:
    """JOD and FLIP of the foveal region, as far as they are installed; arguments as of `measured`."""
    alone = region.alone(image, reference)
    found = {
        "jod": _jod(alone, reference, region, viewer),
        "flip": _flip(alone, reference, region, flip_map),
    }
    return {metric: value for metric, value in found.items() if value is not None}


def acuity_weight(viewer: Viewer, size: tuple[int, int]) -> NDArray[np.float32]:
    """(H, W) cut-off frequency of the eye at each pixel of a frame of that size, relative to the gaze's."""
    angles = eccentricity(viewer.display.viewer(size[1], size[0]), viewer.gaze).astype(np.float64)
    return (geisler_perry(angles) / geisler_perry(np.zeros(1))[0]).astype(np.float32)


def _flip(
    alone: Image, reference: Image, region: Region, metric: Callable[[Image, Image], Map | None]
) -> float | None:
    """Mean of a map over the region; nothing beyond the reach of FLIP's filters is looked at."""
    box = tuple(slice(max(0, side.start - _FLIP_REACH), side.stop + _FLIP_REACH) for side in region.box)
    found = metric(alone[box], reference[box])
    return None if found is None else float(found[region.mask[box]].mean())


def _seen(alone: Image, reference: Image, region: Region) -> tuple[Image, Image]:
    """What of the two pictures a metric without a map is shown."""
    box = region.box if region.name == "foveal" else np.s_[:, :]
    return alone[box], reference[box]


def _jod(alone: Image, reference: Image, region: Region, viewer: Viewer) -> float | None:
    seen = _seen(alone, reference, region)
    height, width = alone.shape[:2]
    x, y = viewer.gaze.pixel(width, height)
    if region.name == "foveal":
        x, y = x - region.box[1].start, y - region.box[0].start
    rows, columns = seen[0].shape[:2]
    return jod(*seen, viewer.display, Gaze(x / columns, y / rows))
