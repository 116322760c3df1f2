"""What is written down beside a sweep's rows: what they depend on, and the options that applied."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import mitsuba as mi

from hybrid.measure.metrics.installed import missing
from hybrid.runtime.machine import machine
from hybrid.sweeps.catalogue import Sweep
from hybrid.sweeps.run import Effort
from hybrid.sweeps.setting import Setting
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest


def identity_of(
    scene: Scene, forest: Forest, sweep: Sweep, settings: list[Setting], effort: Effort
) -> dict[str, Any]:
    """Of a sweep: everything that its rows depend on.

    Args:
        scene, forest: what is rendered.
        sweep: whether its rows are judged.
        settings: the rows.
        effort: how much is measured.
    """
    rows = [
        {**vars(setting), "camera": setting.camera.key.hex(), "viewing": asdict(setting.viewing)}
        for setting in settings
    ]
    return {
        "scene": scene.hash,
        "max_depth": scene.max_depth,
        "forest": forest.digest(),
        "settings": rows,
        "judged": sweep.judged,
        "effort": asdict(effort),
        "missing metrics": missing(),
        "backend": mi.variant(),
        "machine": machine(),
    }


def applied(sweep: Sweep, base: Setting, effort: Effort) -> dict[str, Any]:
    """What was the same for all rows, as JSON has it; nothing of what the sweep varies or ignores.

    Args:
        sweep: which options it leaves alone.
        base: the setting that it varied.
        effort: how much was measured.
    """
    by_option: dict[str, dict[str, Any]] = {
        "--size": {"width": base.camera.width, "height": base.camera.height},
        "--fovea": {"fovea": base.fovea},
        "--fov-a": {"fov_a": base.fov_a},
        "--fov-b": {"fov_b": base.fov_b},
        "--spp": {"spp": base.spp},
        "--acuity-model": {"acuity_model": base.viewing.acuity_model},
        "--reference-spp": {"reference_spp": effort.reference_spp},
    }
    if sweep.scales_radii:
        by_option["--fov-a"] = {}
        by_option["--fov-b"] = {"fov_b_of_fov_a": base.fov_b / base.fov_a}
    found: dict[str, Any] = {}
    for option, values in by_option.items():
        if option not in sweep.ignored:
            found |= values
    return found | {"display": asdict(base.viewing.display)}
