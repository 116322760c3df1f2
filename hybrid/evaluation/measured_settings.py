"""Frame settings with the time and quality measured for them: stored per machine, and chosen for a target."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

from compose.base.errors import UserError, one_line
from compose.base.files import json_text, read_json, write_text
from hybrid.base.cache_folder import scene_folder
from hybrid.base.identity import measured_identity, require_same, short_hash
from hybrid.measure.perceptual_metrics import INSTALL
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

T = TypeVar("T")
# What is varied; everything else is part of the identity.
_VARIED = ("fovea", "spp", "fov_a", "fov_b", "layers", "rate", "scale")


def pareto_front(items: Iterable[T], cost_and_quality: Callable[[T], tuple[float, float]]) -> list[T]:
    """The Pareto-optimal items by time (less is better) and quality (more is), from the fastest to the best.

    Of equal items the first one stays; those of which either is NaN are left out.
    """
    found = [(*cost_and_quality(item), item) for item in items]
    known = [row for row in found if not (math.isnan(row[0]) or math.isnan(row[1]))]
    front: list[T] = []
    best = -math.inf
    for _, quality, item in sorted(known, key=lambda row: (row[0], -row[1])):
        if not front or quality > best:
            front.append(item)
            best = quality
    return front


@dataclass(frozen=True)
class MeasuredSettings:
    """Frame settings with the median time of a frame, and the quality, measured for them.

    Quality is in JOD, or SSIM without FovVideoVDP: the mean over views, and the spread from the least to the
    greatest value, None for a single view. The settings' gaze and camera have no meaning here.

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


class MeasuredStore:
    """Stores measured settings of one kind of frame, single ones or the window's, on this machine.

    The file, in the scene's cache folder, is of one scene, forest and frame size, width and height, and of
    the acuity model, the integrator, the display and the placement of paths of the base.
    """

    def __init__(self, kind: str, scene: Scene, forest: Forest, size: tuple[int, int], base: FrameSettings):
        self._base, (width, height) = base, size
        self._identity = identity = measured_identity(
            scene,
            forest,
            kind=kind,
            width=width,
            height=height,
            acuity_model=base.acuity_model,
            integrator=None if base.integrator is None else base.integrator.value,
            display=asdict(base.display),
            paths=base.paths.value,
        )
        name = f"measured-{kind}-{width}x{height}-{short_hash(identity)}.json"
        self.file = scene_folder(scene.name, scene.hash) / name

    def save(self, metric: str, measured: Sequence[MeasuredSettings]) -> None:
        """Stores settings whose quality was measured in a metric; UserError if they cannot be written."""
        rows = []
        for one in measured:
            found = {"milliseconds": one.milliseconds, "quality": one.quality, "spread": one.spread}
            settings = one.settings.as_json()
            rows.append({**{name: settings[name] for name in _VARIED}, **found})
        write_text(self.file, json_text({"identity": self._identity, "metric": metric, "rows": rows}))

    def load(self) -> tuple[str, list[MeasuredSettings]] | None:
        """The stored metric and settings; None if nothing was stored, UserError if the file is damaged."""
        advice = "delete it to measure again"
        try:
            found = read_json(self.file, finite=False)
            theirs, metric = dict(found["identity"]), str(found["metric"])
            measured = [self._measured(row) for row in found["rows"]]
        except FileNotFoundError:
            return None
        except (OSError, ValueError, LookupError, TypeError, UserError) as error:
            raise UserError(f"{self.file}: is damaged ({one_line(repr(error))}); {advice}") from error
        require_same(theirs, self._identity, f"{self.file}: was measured", advice)
        return metric, measured

    def _measured(self, row: dict[str, Any]) -> MeasuredSettings:
        varied = {name: row[name] for name in _VARIED}
        varied["layers"] = None if varied["layers"] is None else tuple(varied["layers"])
        between = row.get("spread")
        spread = None if between is None else (float(between[0]), float(between[1]))
        milliseconds, quality = float(row["milliseconds"]), float(row["quality"])
        return MeasuredSettings(replace(self._base, **varied), milliseconds, quality, spread)


def chosen(
    metric: str, measured: Sequence[MeasuredSettings], milliseconds: float | None, quality: float | None
) -> MeasuredSettings:
    """The best settings within a time, or the fastest that reach a quality in JOD, or that do both.

    The metric, jod or ssim, is that of the measurements; None allows any time or quality. UserError if there
    are no settings or none meets the target, or if a quality is asked for but was not measured in JOD.
    """
    front = front_of(measured)
    if not front:
        raise UserError("no settings have been measured to choose from; run: hybrid sweep --over trade")
    if quality is not None and metric != "jod":
        raise UserError(
            f"target of {quality:g} JOD: quality was measured in {metric.upper()}; {INSTALL}, then measure "
            "again: hybrid sweep --over trade"
        )
    fitting = [one for one in front if milliseconds is None or one.milliseconds <= milliseconds]
    if not fitting:
        least = front[0].milliseconds
        raise UserError(f"target of {milliseconds:g} ms: the fastest settings take {least:.0f} ms")
    best = fitting[-1]
    if quality is None:
        return best
    if best.quality < quality:
        within = "" if milliseconds is None else f" in {milliseconds:g} ms"
        raise UserError(f"target of {quality:g} JOD: the best settings{within} reach {best.quality:.2f}")
    return next(one for one in fitting if one.quality >= quality)
