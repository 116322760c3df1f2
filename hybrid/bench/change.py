"""How well foveas cope with a scene that has changed since the splats were trained."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hybrid.bench.candidates import Candidates
from hybrid.bench.metrics import image_metrics, means
from hybrid.bench.scene_changes import CHANGES
from hybrid.bench.views import crops, unfitted_views
from hybrid.frame.irradiance import filled_cache
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.runtime.device import device_arrays
from pathtrace.dataset.frames import FrameSet
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Side of the crops over that of the views.
_CROP = 0.4


def bench_change(
    load: Callable[[], Scene],
    frames: FrameSet,
    forest: Forest,
    spp: int,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per change and method: means over crops of the unfitted views, with the old forest.

    Args:
        load: loads the scene anew, to be changed.
        frames, forest: of the scene before the change.
        spp: samples per pixel in the fovea.
        reference_spp: samples per pixel of the changed scene's references.
        progress: called with crops done and crops in total.
    """
    measured = list(crops(unfitted_views(frames), (1,), _CROP))
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    for number, (change, apply) in enumerate(CHANGES.items()):
        for place, crop in enumerate(measured):
            scene = load()
            apply(scene, crop.camera)
            candidates = Candidates(device_arrays(), scene, forest, filled_cache(scene))
            truth = reference(candidates.tracer, crop.camera, reference_spp, REFERENCE_SEED).radiance
            for method, image in candidates.images(crop.camera, spp, 0).items():
                found.setdefault((change, method), []).append(image_metrics(image, truth))
            progress(number * len(measured) + place + 1, len(CHANGES) * len(measured))
    return [
        {"change": change, "method": method, "spp": spp, **means(rows)}
        for (change, method), rows in found.items()
    ]
