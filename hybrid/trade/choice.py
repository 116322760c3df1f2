"""Chooses from measured settings the ones that meet a target time or a target quality."""

from __future__ import annotations

from collections.abc import Sequence

from compose.base.errors import UserError
from hybrid.measure.metrics.fovvideovdp import INSTALL
from hybrid.trade.measured import MeasuredSettings


def chosen(
    metric: str, measured: Sequence[MeasuredSettings], milliseconds: float | None, quality: float | None
) -> MeasuredSettings:
    """The best settings within a time, or the fastest that reach a quality, or the fastest that do both.

    Args:
        metric: in which quality was measured, jod or ssim.
        measured: settings to choose from.
        milliseconds: the time that a frame may take; None for any.
        quality: the quality in JOD that a frame must reach; None for any.

    Raises:
        UserError: there are no settings or none meets the target, or a quality is asked for but was not
            measured in JOD.
    """
    if not measured:
        raise UserError("no settings have been measured to choose from; run: hybrid sweep --over trade")
    if quality is not None and metric != "jod":
        raise UserError(
            f"target of {quality:g} JOD: quality was measured in {metric.upper()}; {INSTALL}, then measure "
            "again: hybrid sweep --over trade"
        )
    fitting = [one for one in measured if milliseconds is None or one.milliseconds <= milliseconds]
    if not fitting:
        least = min(one.milliseconds for one in measured)
        raise UserError(f"target of {milliseconds:g} ms: the fastest settings take {least:.0f} ms")
    if quality is None:
        return max(fitting, key=lambda one: (one.quality, -one.milliseconds))
    good = [one for one in fitting if one.quality >= quality]
    if not good:
        best = max(one.quality for one in fitting)
        within = "" if milliseconds is None else f" in {milliseconds:g} ms"
        raise UserError(f"target of {quality:g} JOD: the best settings{within} reach {best:.2f}")
    return min(good, key=lambda one: one.milliseconds)
