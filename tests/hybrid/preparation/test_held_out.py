"""Quality on the held-out views, layer by layer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid.preparation.forest_errors import held_out_quality
from pathtrace.dataset.captured_frames import read_frame
from splat.lod.forest_renderer import ForestRenderer


def test_each_layer_is_measured_at_its_own_resolution(arrays, frames, trained):
    rows = held_out_quality(frames, trained)
    assert [row["layer"] for row in rows] == [1, 2]
    assert [row["nodes"] for row in rows] == list(trained.counts)
    # Few samples per pixel and few steps: rough, but an image of this scene and no other.
    assert min(row["psnr"] for row in rows) > 12
    assert all(0 < row["ssim"] <= 1 for row in rows)


def test_the_finest_layer_is_compared_with_the_captured_frames(arrays, frames, trained):
    entry = frames.held_out[0]
    shown = ForestRenderer(arrays, trained).render_layer(entry.camera, 2).numpy()
    clipped = (np.clip(image, 0, 1) for image in (shown, read_frame(entry.file).radiance))
    srgb = [np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055) for x in clipped]
    expected = -10 * np.log10(np.mean((srgb[0] - srgb[1]) ** 2))
    assert held_out_quality(frames, trained)[-1]["psnr"] == pytest.approx(expected, abs=0.01)


def test_several_views_count_equally(frames, trained):
    views = frames.training[:2]
    alone = [held_out_quality(of_views(frames, [view]), trained)[0] for view in views]
    both = held_out_quality(of_views(frames, views), trained)[0]
    for metric in ("psnr", "ssim"):
        assert both[metric] == pytest.approx((alone[0][metric] + alone[1][metric]) / 2)


def test_without_held_out_views_there_is_no_quality(frames, trained):
    rows = held_out_quality(of_views(frames, []), trained)
    assert [{*row} for row in rows] == [{"layer", "nodes"}] * 2


def of_views(frames, views):
    """The frame set with these views held out."""
    return replace(frames, entries=[replace(view, held_out=True) for view in views])
