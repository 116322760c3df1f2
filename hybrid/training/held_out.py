"""Quality of a forest on the held-out views of frames."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid.measure.metrics.similarity import quality
from hybrid.runtime.device import device_arrays
from hybrid.training.posed import Frames, posed_view
from hybrid.training.views import training_view
from pathtrace.dataset.frames import FrameSet
from splat.lod.renderer import ForestRenderer
from splat.model.forest import Forest
from splat.training.views import TrainingView, reduced


def held_out_quality(frames: Frames, forest: Forest) -> list[dict[str, Any]]:
    """Mean PSNR and SSIM of each layer alone over the held-out views, coarsest first.

    Layer l is compared with frames that are reduced to its resolution. Frames with numbers that are not
    finite are left out.

    Returns:
        Per layer: layer (1 to L), nodes and, if there are held-out views, psnr in dB and ssim.
    """
    renderer = ForestRenderer(device_arrays(), forest)
    views = _views(frames)
    rows: list[dict[str, Any]] = []
    for number, count in enumerate(forest.counts, start=1):
        factor = 2 ** (len(forest.counts) - number)
        found = []
        for view in (reduced(view, factor) for view in views):
            renderer.set_time(view.time)
            found.append(quality(renderer.render_layer(view.camera, number).numpy(), view.radiance))
        means = {name: float(np.mean([row[name] for row in found])) for name in found[0]} if found else {}
        rows.append({"layer": number, "nodes": count, **means})
    return rows


def _views(frames: Frames) -> list[TrainingView]:
    """The held-out views."""
    if not isinstance(frames, FrameSet):
        return [posed_view(image) for image in frames.held_out]
    # A frame that is not finite tells nothing: its PSNR would be NaN, and the mean as well.
    views = (training_view(entry, frames.courses) for entry in frames.held_out)
    return [view for view in views if view.is_finite]
