"""Threads of Dr.Jit and torch, which compete for the same CPU cores."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr
import torch

from hybrid.runtime.device import torch_device

# Images of up to this many pixels gain nothing from further threads of torch: each of its many small steps
# takes less time than waking them. And where other processes are busy, threads wait for each other's turns.
_FEW_PIXELS = 256 * 256


@contextmanager
def torch_working_on(pixels: int) -> Iterator[None]:
    """Gives torch the threads that suit images of a number of pixels.

    For large images, Dr.Jit's worker threads are stopped meanwhile: they spin while they wait and take cores
    from torch. Stopping and restarting them takes 0.1 ms. Where torch works on a card, nothing changes.
    """
    if torch_device().type == "cuda":
        yield
        return
    torch_threads, drjit_threads = torch.get_num_threads(), dr.thread_count()
    if pixels <= _FEW_PIXELS:
        torch.set_num_threads(1)
    else:
        dr.set_thread_count(1)
    try:
        yield
    finally:
        torch.set_num_threads(torch_threads)
        dr.set_thread_count(drjit_threads)
