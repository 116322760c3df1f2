"""Quality of a sweep's frames, with the gaze at the centre."""

from __future__ import annotations

from dataclasses import replace

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


def quality_of(setting: Setting, method: HybridMethod, truth: Reference) -> dict[str, float]:
    """Metrics of a row's frame by region and metric, such as "foveal jod"."""
    image = method.render(setting.camera, Gaze(), 0).image
    viewer = Viewer(setting.frame.display, Gaze())
    rows = metric_rows(image, truth.radiance, regions_of(setting), viewer)
    return {f"{row['region']} {row['metric']}": float(row["value"]) for row in rows}
