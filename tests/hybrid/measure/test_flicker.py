"""Flicker of videos, in thresholds of the eye."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.eye.display import Display
from compose.eye.flicker import flicker_sensitivity
from compose.eye.gaze import Gaze, eccentricity
from hybrid.measure.flicker import added_flicker

# Of 60 degrees; a degree at its centre is 0.73 pixels.
DISPLAY = Display(48, 32, 60.0, luminance=100.0)
FPS, COUNT = 30, 30
LEFT = [Gaze(0.0, 0.5)] * COUNT


def still(level: float = 0.4, count: int = COUNT) -> list[np.ndarray]:
    return [np.full((32, 48, 3), level, np.float32) for _ in range(count)]


def flickering(hz: float, contrast: float, first_column: int = 0, fps: float = FPS) -> list[np.ndarray]:
    """Frames whose luminance over that of a display that shows black as one percent is a sine."""
    frames = still()
    for number, frame in enumerate(frames):
        change = contrast * 0.41 * np.sin(2 * np.pi * hz * number / fps)
        frame[:, first_column:] += np.float32(change)
    return frames


def plainly(hz: float, contrast: float) -> float:
    """The flicker of such frames, block by block."""
    away, worst = eccentricity(DISPLAY.viewer(48, 32), LEFT[0]), 0.0
    for degrees in (1.0, 2.0, 4.0, 8.0):
        side, seen = round(degrees * DISPLAY.pixels_per_degree), []
        for top in range(0, 32 - side + 1, side):
            for left in range(0, 48 - side + 1, side):
                off = float(away[top : top + side, left : left + side].mean())
                if off > 10:
                    sensitivity = flicker_sensitivity(np.array([hz]), off, 41.0, degrees**2)
                    seen.append(contrast * float(sensitivity[0]))
        worst = max(worst, float(np.percentile(seen, 99)))
    return worst


@pytest.mark.parametrize("hz", [4.0, 6.0, 10.0])
def test_a_sine_has_its_contrast_times_the_sensitivity_to_it(hz):
    found = added_flicker(flickering(hz, 0.05), still(), LEFT, FPS, DISPLAY)
    # Its window spreads it over neighbouring frequencies.
    assert found == pytest.approx(plainly(hz, 0.05), rel=0.1)


def test_flicker_is_proportional_to_contrast_and_less_where_it_is_fast():
    found = [
        added_flicker(flickering(hz, contrast, fps=240), still(), LEFT, 240, DISPLAY)
        for hz, contrast in ((16, 0.02), (16, 0.04), (40, 0.02), (80, 0.02))
    ]
    assert found[1] == pytest.approx(2 * found[0], rel=1e-3)
    assert found[0] > 4 * found[2] > 16 * found[3] > 0


def test_what_the_reference_does_as_well_is_no_flicker():
    moving = flickering(6.0, 0.3)
    assert added_flicker(moving, moving, LEFT, FPS, DISPLAY) == 0
    assert added_flicker(still(0.5), still(), LEFT, FPS, DISPLAY) == pytest.approx(0, abs=1e-4)


def test_only_the_periphery_counts():
    """The gaze is at the left edge; ten degrees are eight pixels there."""
    near = still()
    for number in range(0, COUNT, 2):
        near[number][14:18, :3] += 0.3
    assert added_flicker(near, still(), LEFT, FPS, DISPLAY) == 0
    assert added_flicker(flickering(6.0, 0.1, 12), still(), LEFT, FPS, DISPLAY) > 0.5
    narrow = replace(DISPLAY, fov=1.0)
    assert added_flicker(near, still(), LEFT, FPS, narrow) is None


def test_what_the_display_clips_is_no_flicker():
    bright, brighter = still(2.0), still(2.0)
    brighter[5] += 3
    assert added_flicker(brighter, bright, LEFT, FPS, DISPLAY) == 0


@pytest.mark.parametrize("count", [2, 3, 20])
def test_a_single_step_is_seen_in_clips_of_any_length(count):
    frames, gazes = still(count=count), LEFT[:count]
    frames[1] = frames[1] + np.float32(0.2)
    assert added_flicker(frames, still(count=count), gazes, FPS, DISPLAY) > 1


def test_dim_displays_flicker_less():
    dim = replace(DISPLAY, luminance=5.0)
    shown = [added_flicker(flickering(14.0, 0.05), still(), LEFT, FPS, one) for one in (dim, DISPLAY)]
    assert shown[0] < shown[1]
