"""Bias of integrators: images of very many samples, and how they differ in large blocks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from pathtrace.trace.film import frame_positions
from pathtrace.trace.image import radiance_image
from pathtrace.trace.tracer import Tracer

# Side in pixels of the blocks in which bias is looked for.
BLOCK = 32
# Samples per pixel in one pass of an image of many.
PASS = 64


def block_errors(image: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Relative errors of the blocks of an (H, W, 3) image that are not black; a single 0 if all are.

    Blocks that are cut by the frame's border count as well.
    """
    found, expected = _block_sums(image), _block_sums(truth)
    lit = expected > 0
    return found[lit] / expected[lit] - 1 if lit.any() else np.zeros(1)


def relative_errors(image: NDArray[np.float64], truth: NDArray[np.float64]) -> dict[str, float]:
    """Relative errors of the mean of an (H, W, 3) image, and of its blocks: the worst and a high one."""
    blocks = np.abs(block_errors(image, truth))
    mean = float(image.mean() / truth.mean() - 1) if truth.mean() > 0 else 0.0
    return {"mean": mean, "worst_block": float(blocks.max()), "p95_block": float(np.percentile(blocks, 95))}


def _block_sums(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over blocks of BLOCK x BLOCK pixels."""
    sums = image.sum(axis=2)
    for axis in (0, 1):
        sums = np.add.reduceat(sums, np.arange(0, image.shape[axis], BLOCK), axis=axis)
    return sums


def converged(
    tracer: Tracer, camera: Camera, passes: int, seed: int, advance: Callable[[int], None]
) -> NDArray[np.float64]:
    """(H, W, 3) mean of many samples per pixel, in float64."""
    total = np.zeros((camera.height, camera.width, 3))
    for number in range(passes):
        total += frame_of(tracer, camera, PASS, seed + number)
        advance(PASS)
    return total / passes


def advancing(progress: Callable[[int, int], None], total: int) -> Callable[[int], None]:
    """A function that is called with samples per pixel as they are done, and reports their sum and total."""
    done = 0

    def advance(samples: int) -> None:
        nonlocal done
        done += samples
        progress(done, total)

    return advance


def frame_of(tracer: Tracer, camera: Camera, spp: int, seed: int) -> Image:
    """(H, W, 3) a raw frame."""
    return radiance_image(tracer, camera, frame_positions(camera), camera.width, spp, seed)
