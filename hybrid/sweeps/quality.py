"""Quality of a sweep's frames, with the gaze at the centre: means over views, and their ranges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compose.eye.gaze import Gaze
from hybrid.measure.quality import Viewer, metric_rows
from hybrid.measure.reference import Reference
from hybrid.measure.regions import Region, plain_regions
from hybrid.methods.hybrid import HybridMethod
from hybrid.sweeps.setting import Setting

# Regions whose quality is measured.
_REGIONS = ("whole", "foveal", "peripheral")


def regions_of(setting: Setting) -> dict[str, Region]:
    """The regions of a row whose quality is measured, by name.

    Raises:
        UserError: one is empty.
    """
    size = setting.camera.height, setting.camera.width
    return plain_regions(replace(setting.frame, gaze=Gaze()).foveation, size, _REGIONS)


def quality_of(
    setting: Setting, method: HybridMethod, truths: list[Reference]
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Metrics of a row's frames by region and metric, such as "foveal jod".

    Args:
        setting: of the row.
        method: renders its frames.
        truths: references of its views.

    Returns:
        Means over the views, and the least and the greatest value. A metric that has no value in one of the
        views is left out: its mean would be of other views than those of other rows.
    """
    viewer, parts = Viewer(setting.frame.display, Gaze()), regions_of(setting)
    found: dict[str, list[float]] = {}
    for seed, (view, truth) in enumerate(zip(setting.seen, truths, strict=True)):
        image = method.render(view, Gaze(), seed).image
        for row in metric_rows(image, truth.radiance, parts, viewer):
            found.setdefault(f"{row['region']} {row['metric']}", []).append(float(row["value"]))
    known = {name: values for name, values in found.items() if len(values) == len(truths)}
    ranges = {name: (min(values), max(values)) for name, values in known.items()}
    return {name: float(np.mean(values)) for name, values in known.items()}, ranges
