"""What is stored with a sweep's rows: their identity, and the settings they have in common."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from hybrid.measure.metrics.installed import missing
from hybrid.store.identity import measured_identity
from hybrid.sweeps.catalogue import Sweep
from hybrid.sweeps.effort import Effort
from hybrid.sweeps.setting import Setting
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest


def identity_of(
    scene: Scene, forest: Forest, sweep: Sweep, settings: list[Setting], effort: Effort
) -> dict[str, Any]:
    """Everything that the rows of a sweep depend on.

    Args:
        scene, forest: what is rendered.
        sweep: whether its rows have quality.
        settings: the rows.
        effort: how much is measured.
    """
    rows = [
        {
            **vars(setting),
            "camera": setting.camera.key.hex(),
            "frame": setting.frame.as_json(),
            "views": [view.key.hex() for view in setting.views],
        }
        for setting in settings
    ]
    metrics = {"missing metrics": missing()} if sweep.with_quality else {}
    return measured_identity(
        scene, forest, settings=rows, quality=sweep.with_quality, effort=asdict(effort), **metrics
    )


def applied(sweep: Sweep, base: Setting, effort: Effort) -> dict[str, Any]:
    """The settings that all rows have in common, without those that the sweep varies or ignores, as JSON.

    Args:
        sweep: what it varies and ignores.
        base: the setting that it varied.
        effort: how much was measured.
    """
    frame = base.frame
    common: dict[str, dict[str, Any]] = {
        "size": {"width": base.camera.width, "height": base.camera.height},
        "fovea": {"fovea": frame.fovea.value},
        "fov_a": {"fov_a": frame.fov_a},
        "fov_b": {"fov_b": frame.fov_b},
        "spp": {"spp": frame.spp},
        "acuity_model": {"acuity_model": frame.acuity_model},
        "reference_spp": {"reference_spp": effort.reference_spp},
    }
    if sweep.scales_radii:
        common["fov_a"] = {}
        common["fov_b"] = {"fov_b_of_fov_a": frame.fov_b / frame.fov_a}
    found: dict[str, Any] = {}
    for quantity, values in common.items():
        if quantity not in sweep.ignored:
            found |= values
    varies = "fovea" in sweep.ignored and frame.integrator is None
    integrator = "by fovea" if varies else frame.used_integrator.value
    return found | {"integrator": integrator, "display": asdict(frame.display)}
