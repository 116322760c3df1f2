"""Frame settings with the time and quality measured for them, stored per machine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from compose.base.errors import UserError, one_line
from compose.base.files import write_whole
from compose.base.json_file import read_json
from hybrid.frame.settings import FrameSettings
from hybrid.runtime.valid_json import json_text
from hybrid.store.cache import scene_folder
from hybrid.store.identity import measured_identity, require_same, short_hash
from hybrid.trade.pareto import pareto_front
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# What is varied; everything else is part of the identity.
_VARIED = ("fovea", "spp", "fov_a", "fov_b", "layers", "rate", "scale")


@dataclass(frozen=True)
class MeasuredSettings:
    """Frame settings with the time and quality measured for them.

    Attributes:
        settings: of the frame; its gaze and camera have no meaning here.
        milliseconds: median time of a frame.
        quality: JOD, or SSIM if FovVideoVDP is not installed; mean over the views in which it was measured.
        spread: its least and its greatest value over these views; None for a single view.

    Raises:
        ValueError: the time or the quality is not finite, or the time is not positive: such settings could
            neither be chosen nor be left out for a reason.
    """

    settings: FrameSettings
    milliseconds: float
    quality: float
    spread: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not (0 < self.milliseconds < math.inf and math.isfinite(self.quality)):
            raise ValueError(
                f"{self.milliseconds} ms, quality {self.quality}: must be finite, the time above 0"
            )


def front_of(measured: Sequence[MeasuredSettings]) -> list[MeasuredSettings]:
    """The Pareto-optimal settings, ordered from the fastest to the best."""
    return pareto_front(measured, lambda one: (one.milliseconds, one.quality))


@dataclass(frozen=True)
class MeasuredStore:
    """Stores measured settings of one scene, forest, frame size, acuity model, display and machine.

    Attributes:
        file: in the scene's cache folder.
        identity: everything that the measurements depend on.
        base: settings with the acuity model and the display of the measurements.
    """

    file: Path
    identity: dict[str, Any]
    base: FrameSettings

    @staticmethod
    def of(
        kind: str, scene: Scene, forest: Forest, size: tuple[int, int], base: FrameSettings
    ) -> MeasuredStore:
        """The store for one kind of frame.

        Args:
            kind: name of what is measured, such as single frames or those of the window.
            scene, forest: what is rendered.
            size: width and height of the frame in pixels.
            base: settings with the acuity model, the integrator and the display.
        """
        width, height = size
        identity = measured_identity(
            scene,
            forest,
            kind=kind,
            width=width,
            height=height,
            acuity_model=base.acuity_model,
            integrator=None if base.integrator is None else base.integrator.value,
            display=asdict(base.display),
        )
        name = f"measured-{kind}-{width}x{height}-{short_hash(identity)}.json"
        return MeasuredStore(scene_folder(scene.name, scene.hash) / name, identity, base)

    def save(self, metric: str, measured: Sequence[MeasuredSettings]) -> None:
        """Stores settings whose quality was measured in a metric.

        Raises:
            UserError: the cache folder cannot be written.
        """
        rows = [_row(one) for one in measured]
        text = json_text({"identity": self.identity, "metric": metric, "rows": rows})
        write_whole(self.file, lambda part: part.write_text(text))

    def load(self) -> tuple[str, list[MeasuredSettings]] | None:
        """The stored metric and settings; None if nothing was stored.

        Raises:
            UserError: the file is damaged.
        """
        advice = "delete it to measure again"
        try:
            found = read_json(self.file, finite=False)
            theirs, metric = dict(found["identity"]), str(found["metric"])
            measured = [self._measured(row) for row in found["rows"]]
        except FileNotFoundError:
            return None
        except (OSError, ValueError, LookupError, TypeError, UserError) as error:
            raise UserError(f"{self.file}: is damaged ({one_line(repr(error))}); {advice}") from error
        require_same(theirs, self.identity, f"{self.file}: was measured", advice)
        return metric, measured

    def _measured(self, row: dict[str, Any]) -> MeasuredSettings:
        varied = {name: row[name] for name in _VARIED}
        varied["layers"] = None if varied["layers"] is None else tuple(varied["layers"])
        between = row.get("spread")
        spread = None if between is None else (float(between[0]), float(between[1]))
        milliseconds, quality = float(row["milliseconds"]), float(row["quality"])
        return MeasuredSettings(replace(self.base, **varied), milliseconds, quality, spread)


def _row(one: MeasuredSettings) -> dict[str, Any]:
    settings = one.settings.as_json()
    varied = {name: settings[name] for name in _VARIED}
    return {**varied, "milliseconds": one.milliseconds, "quality": one.quality, "spread": one.spread}
