"""What a fused fovea is worth: compared with each of its parents, on views that nothing was fitted to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from hybrid.bench.candidates import Candidates
from hybrid.bench.metrics import image_metrics, means
from hybrid.bench.views import crops, unfitted_views
from hybrid.frame.irradiance import cache_for
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.runtime.device import device_arrays
from pathtrace.dataset.frames import FrameSet
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Side of the crops over that of the views.
_CROP = 0.4


@dataclass(frozen=True)
class FusionEffort:
    """How much is measured.

    Attributes:
        counts: samples per pixel.
        scales: resolutions of the crops over that of the frame set.
        seeds: runs of each.
        reference_spp: samples per pixel of the references.
    """

    counts: tuple[int, ...] = (1, 2, 4, 16, 64)
    scales: tuple[int, ...] = (1, 2)
    seeds: int = 2
    reference_spp: int = 1024


def bench_fusion(
    scene: Scene,
    frames: FrameSet,
    forest: Forest,
    effort: FusionEffort,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per resolution, sample count and method: means over views and seeds.

    Args:
        scene, forest: what is rendered.
        frames: that the forest was trained on; its unfitted views are measured.
        effort: how much is measured.
        progress: called with crops done and crops in total.
    """
    found: dict[tuple[int, int, str], list[dict[str, float]]] = {}
    limits: dict[int, list[float]] = {}
    candidates = Candidates(device_arrays(), scene, forest, cache_for(scene))
    measured = list(crops(unfitted_views(frames), effort.scales, _CROP))
    for done, crop in enumerate(measured):
        truth = reference(candidates.tracer, crop.camera, effort.reference_spp, REFERENCE_SEED)
        limits.setdefault(crop.scale, []).append(truth.psnr())
        for spp, seed in product(effort.counts, range(effort.seeds)):
            for method, image in candidates.images(crop.camera, spp, seed).items():
                rows = found.setdefault((crop.scale, spp, method), [])
                rows.append(image_metrics(image, truth.radiance))
        progress(done + 1, len(measured))
    return [
        {
            "scene": scene.name,
            "scale": scale,
            "spp": spp,
            "method": method,
            "views": len(measured) // len(effort.scales),
            "seeds": effort.seeds,
            "reference_psnr": float(np.mean(limits[scale])),
            **means(rows),
        }
        for (scale, spp, method), rows in found.items()
    ]
