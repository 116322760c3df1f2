"""Which settings give a frame in a given time, or of a given quality: remembered from measurement."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from compose.base.errors import UserError
from compose.base.files import write_whole
from compose.eye.display import Display
from hybrid.measure.metrics.fovvideovdp import INSTALL
from hybrid.runtime.machine import machine
from hybrid.store.cache import scene_folder
from hybrid.store.identity import require_same, short_hash
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# The quality of the whole frame that is traded against time, SSIM where FovVideoVDP is not installed.
_QUALITY = ("jod", "ssim")


@dataclass(frozen=True)
class Choice:
    """Settings, and what they were measured to take and give.

    Attributes:
        fovea, spp, fov_a, fov_b: as the options of `hybrid render`.
        milliseconds: median.
        quality: in JOD, or SSIM.
    """

    fovea: str
    spp: int
    fov_a: float
    fov_b: float
    milliseconds: float
    quality: float


@dataclass(frozen=True)
class Trade:
    """All choices that were measured, and in which metric their quality is: jod or ssim."""

    metric: str
    choices: list[Choice]


def trade_identity(
    scene: Scene, forest: Forest, size: tuple[int, int], acuity_model: str, display: Display
) -> dict[str, Any]:
    """Everything that times and quality depend on, but for what is chosen and for the view.

    Args:
        scene, forest: what is rendered.
        size: width and height of the frame.
        acuity model: name of the acuity model.
        display: that the frame is shown on.
    """
    return {
        "scene": scene.hash,
        "max_depth": scene.max_depth,
        "forest": forest.digest(),
        "width": size[0],
        "height": size[1],
        "acuity_model": acuity_model,
        "display": asdict(display),
        "backend": mi.variant(),
        "machine": machine(),
    }


def remember_trade(scene: Scene, identity: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """Keeps the rows of a sweep over the trade.

    Raises:
        UserError: the cache folder cannot be written.
    """
    metric = next(name for name in _QUALITY if f"whole {name}" in rows[0]["quality"])
    text = json.dumps({"identity": identity, "metric": metric, "rows": rows}, indent=1) + "\n"
    write_whole(_file(scene, identity), lambda part: part.write_text(text))


def remembered_trade(scene: Scene, identity: dict[str, Any], command: str) -> Trade:
    """What was measured of a scene for that identity.

    Args:
        scene, identity: as they were remembered.
        command: what measures it.

    Raises:
        UserError: nothing was, or the file is damaged.
    """
    file = _file(scene, identity)
    try:
        found = json.loads(file.read_text())
        require_same(dict(found["identity"]), identity, f"{file}: was measured", f"run: {command}")
        metric = str(found["metric"])
        choices = [
            Choice(
                r["fovea"], r["spp"], r["fov_a"], r["fov_b"], r["ms"]["p50"], r["quality"][f"whole {metric}"]
            )
            for r in found["rows"]
        ]
    except FileNotFoundError:
        raise not_measured(command) from None
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise UserError(f"{file}: is damaged ({error!r}); run: {command}") from error
    return Trade(metric, choices)


def not_measured(command: str) -> UserError:
    """Says what measures a trade."""
    return UserError(f"--target-ms, --target-jod: these settings were not measured here yet; run: {command}")


def _file(scene: Scene, identity: dict[str, Any]) -> Path:
    size = f"{identity['width']}x{identity['height']}"
    return scene_folder(scene.name, scene.hash) / f"trade-{size}-{short_hash(identity)}.json"


def chosen(trade: Trade, milliseconds: float | None, quality: float | None) -> Choice:
    """The best within a time, or the fastest of a quality; with both, the fastest of the quality in the time.

    Args:
        trade: what there is.
        milliseconds: that it may take.
        quality: in JOD, that it must have.

    Raises:
        UserError: there is none, or its quality is not known in JOD.
    """
    if quality is not None and trade.metric != "jod":
        raise UserError(
            f"--target-jod {quality:g}: what was measured has its quality in {trade.metric.upper()}; "
            f"{INSTALL}, then run hybrid sweep --over trade again"
        )
    choices = trade.choices
    fitting = [c for c in choices if milliseconds is None or c.milliseconds <= milliseconds]
    if not fitting:
        least = min(choices, key=lambda c: c.milliseconds)
        raise UserError(
            f"--target-ms {milliseconds:g}: the fastest settings take {least.milliseconds:.0f} ms"
        )
    if quality is None:
        return max(fitting, key=lambda c: (c.quality, -c.milliseconds))
    good = [c for c in fitting if c.quality >= quality]
    if not good:
        best = max(fitting, key=lambda c: c.quality)
        within = "" if milliseconds is None else f" in {milliseconds:g} ms"
        raise UserError(f"--target-jod {quality:g}: the best settings{within} reach {best.quality:.2f}")
    return min(good, key=lambda c: c.milliseconds)
