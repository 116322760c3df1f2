"""Which settings give a frame in a given time, or of a given quality: remembered from measurement."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from compose.errors import UserError
from hybrid.cache import scene_folder
from pathtrace.scene import Scene

T = TypeVar("T")
# The quality that is traded against time: FovVideoVDP of the whole frame, and SSIM where it is not installed.
_QUALITY = ("whole jod", "whole ssim")


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


def unbeaten(items: Iterable[T], place: Callable[[T], tuple[float, float]]) -> list[T]:
    """Those that no other is both faster and better than, from the fastest to the best.

    Args:
        items: to choose among.
        place: of an item, its time and its quality, of which more is better.
    """
    best: list[T] = []
    for item in sorted(items, key=lambda one: (place(one)[0], -place(one)[1])):
        if not best or place(item)[1] > place(best[-1])[1]:
            best.append(item)
    return best


def trade_file(scene: Scene, width: int, height: int) -> Path:
    """Where the trade of a scene at a frame size is remembered."""
    return scene_folder(scene.name, scene.hash) / f"trade-{width}x{height}.json"


def remembered_trade(scene: Scene, width: int, height: int) -> list[Choice]:
    """All choices that were measured.

    Raises:
        UserError: none was, or the file is damaged.
    """
    file = trade_file(scene, width, height)
    try:
        rows = json.loads(file.read_text())
        metric = next(name for name in _QUALITY if name in rows[0]["quality"])
        return [
            Choice(r["fovea"], r["spp"], r["fov_a"], r["fov_b"], r["ms"]["p50"], r["quality"][metric])
            for r in rows
        ]
    except FileNotFoundError:
        raise UserError(
            f"--target-ms, --target-jod: nothing was measured for {scene.name} at {width} x {height} yet; "
            f"run: hybrid sweep {scene.name} --over trade --size {width} {height}"
        ) from None
    except (OSError, ValueError, LookupError, TypeError, StopIteration) as error:
        raise UserError(f"{file}: is damaged ({error!r}); run hybrid sweep --over trade again") from error


def chosen(choices: list[Choice], milliseconds: float | None, quality: float | None) -> Choice:
    """The best within a time, or the fastest of a quality; with both, the fastest of the quality in the time.

    Raises:
        UserError: there is none.
    """
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
