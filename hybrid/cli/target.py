"""Targets of `hybrid render`: settings chosen from those that were measured."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from compose.base.errors import UserError
from hybrid.render.frame_settings import DEFAULTS, FrameSettings

if TYPE_CHECKING:
    from pathtrace.scene.scene import Scene
    from splat.model.forest import Forest


@dataclass(frozen=True)
class TradeTarget:
    """The milliseconds that a frame may take and the JOD that it must reach; None for any.

    The command measures the settings to choose from.
    """

    milliseconds: float | None
    jod: float | None
    command: str

    @property
    def is_set(self) -> bool:
        """Whether there is a target at all."""
        return self.milliseconds is not None or self.jod is not None

    def require_forest(self, scene: Scene, given: Path | None) -> None:
        """Checks that settings can have been measured: there must be a forest already."""
        from hybrid.base.cache_folder import newest_forest

        if self.is_set and given is None and newest_forest(scene) is None:
            raise self._not_measured()

    def applied(self, scene: Scene, forest: Forest, settings: FrameSettings) -> FrameSettings:
        """The settings that meet the target, the given ones without one; UserError if none meets it."""
        if not self.is_set:
            return settings
        from hybrid.evaluation.measured_settings import MeasuredStore, chosen

        camera, _ = settings.resolved(scene.camera)
        found = MeasuredStore("trade", scene, forest, (camera.width, camera.height), settings).load()
        if found is None:
            raise self._not_measured()
        choice, metric = chosen(*found, self.milliseconds, self.jod), found[0].upper()
        best, range_ = choice.settings, ""
        if choice.spread is not None:
            low, high = choice.spread
            range_ = f"; {metric} {choice.quality:.4g} ({low:.4g} to {high:.4g})"
        print(
            f"--fovea {best.fovea.value} --spp {best.spp} --fov-a {best.fov_a:g} --fov-b {best.fov_b:g}: "
            f"measured to take {choice.milliseconds:.0f} ms in views that nothing was fitted to{range_}"
        )
        return replace(settings, fovea=best.fovea, spp=best.spp, fov_a=best.fov_a, fov_b=best.fov_b)

    def _not_measured(self) -> UserError:
        return UserError(
            f"--target-ms, --target-jod: these settings have not been measured here; run: {self.command}"
        )


def measuring_command(
    scene: str,
    forest: Path | None,
    size: tuple[int, int],
    settings: FrameSettings,
    display: str,
    backend: str,
) -> str:
    """The command that measures what a target chooses from, with the options that matter."""
    options = [
        ("--acuity-model", settings.acuity_model, DEFAULTS.acuity_model),
        ("--display", display, "desktop"),
        ("--backend", backend, "auto"),
    ]
    words = ["hybrid", "sweep", scene, "--over", "trade", "--size", str(size[0]), str(size[1])]
    words += [] if forest is None else ["--forest", str(forest)]
    words += [word for option, value, default in options if value != default for word in (option, value)]
    return shlex.join(words)
