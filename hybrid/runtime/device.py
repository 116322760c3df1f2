"""The device on which a frame's arrays live: the one that Mitsuba uses."""

from __future__ import annotations

import mitsuba as mi
import torch

from compose.base.arrays import Arrays


def device_arrays() -> Arrays:
    """Array types of the selected backend; requires that `select_backend` has been called."""
    return Arrays("cuda" if str(mi.variant()).startswith("cuda") else "llvm")


def torch_device() -> torch.device:
    """Where torch computes on what is on the device: there, if this torch can."""
    on_cuda = device_arrays().backend == "cuda" and torch.cuda.is_available()
    return torch.device("cuda" if on_cuda else "cpu")
