"""How much a video flickers beyond its reference, in thresholds of the eye."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compose.eye.display import Display
from compose.eye.flicker import flicker_sensitivity
from compose.eye.gaze import Gaze, eccentricity
from compose.image.colour import Image, luminance

# Degrees from the gaze from which flicker counts as that of the periphery.
PERIPHERY = 10.0
# Sides in degrees of the blocks whose means flicker, and this percentile of all blocks of a size.
_SIDES, _PERCENTILE = (0.5, 1.0, 2.0, 4.0, 8.0), 99.0
# Seconds of a fixation, in which frequencies are told apart.
_WINDOW = 0.5
# A display's black in a lit room, as a share of its white.
_BLACK = 0.01


def added_flicker(
    images: Sequence[Image], truths: Sequence[Image], gazes: Sequence[Gaze], fps: float, display: Display
) -> float | None:
    """Flicker that a video adds in the periphery, over what the eye just sees; None if there is none.

    What differs between images and reference (H, W, 3), as the display shows both, is averaged over blocks of
    half a degree to eight degrees, and told apart by frequency in windows of half a second. Each amplitude
    over the reference's luminance is weighed with the sensitivity to it (`flicker_sensitivity`); their
    energies add up. Found is the 99th percentile over blocks more than ten degrees from the gaze and over
    windows, of the size of blocks in which it is most: over 1, somebody who looks elsewhere sees it.
    """
    height, width = images[0].shape[:2]
    viewer = display.viewer(width, height)
    shown, expected = (
        display.luminance * np.stack([luminance(np.clip(one, 0, 1)) for one in of]) for of in (images, truths)
    )
    away = np.stack([eccentricity(viewer, gaze) for gaze in gazes])
    length = min(len(images), max(2, round(_WINDOW * fps)))
    starts = sorted({*range(0, len(images) - length + 1, max(1, length // 2)), len(images) - length})
    worst = []
    for degrees in _SIDES:
        side = round(degrees * display.pixels_per_degree)
        if not 0 < side <= min(height, width):
            continue
        added, usual, angle = (_blocks(of, side) for of in (shown - expected, expected, away))
        found = []
        for start in starts:
            window = slice(start, start + length)
            level, off = usual[window].mean(axis=0) + _BLACK * display.luminance, angle[window].mean(axis=0)
            contrasts = _contrasts(added[window]) / level
            frequency = np.arange(1, len(contrasts) + 1)[:, None] * fps / length
            seen = contrasts * flicker_sensitivity(frequency, off, level, degrees**2)
            found.append(np.sqrt((seen**2).sum(axis=0))[off > PERIPHERY])
        if all_blocks := np.concatenate(found).tolist():
            worst.append(float(np.percentile(all_blocks, _PERCENTILE)))
    return max(worst, default=None)


def _blocks(frames: NDArray[np.floating], side: int) -> NDArray[np.float64]:
    """(T, B) means of frames (T, H, W) over whole blocks."""
    rows, columns = (size // side for size in frames.shape[1:])
    whole = frames[:, : rows * side, : columns * side].reshape(-1, rows, side, columns, side)
    return whole.mean(axis=(2, 4), dtype=np.float64).reshape(len(frames), -1)


def _contrasts(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(K, B) amplitudes of B signals (T, B) at the K frequencies of T samples but 0, by a Hann window.

    Their squares sum to twice the mean square of a signal: to that of the amplitude of a sine.
    """
    count = len(values)
    taper = np.sin(np.pi * np.arange(1, count + 1) / (count + 1)) ** 2
    spectrum = np.abs(np.fft.rfft((values - values.mean(axis=0)) * taper[:, None], axis=0))[1:]
    # At half the rate, both sides of the spectrum are one.
    sides = np.where(2 * np.arange(1, len(spectrum) + 1) == count, 1.0, np.sqrt(2))
    found: NDArray[np.float64] = np.sqrt(2) * sides[:, None] * spectrum / np.sqrt(count * (taper**2).sum())
    return found
