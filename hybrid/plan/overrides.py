"""Decisions that a user takes instead of a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from compose.base.errors import UserError
from hybrid.frame.settings import MOST_SPP
from hybrid.plan.appearance import DEGREE, FRAME_PRECISION, HALF, SINGLE
from hybrid.plan.decision import Decision, Value
from hybrid.plan.detail import GAUSSIANS
from hybrid.plan.layers import LAYERS
from hybrid.plan.paths import DEPTH, ROULETTE
from hybrid.plan.plan import ScenePlan
from hybrid.plan.samples import DENOISED, DENOISING, RAW, SAMPLES
from splat.model.gaussians import MAX_DEGREE

# Least and greatest whole number that each item may be.
_NUMBERS = {
    DEPTH: (1, 1_000_000),
    ROULETTE: (1, 1_000_000),
    DEGREE: (0, MAX_DEGREE),
    LAYERS: (1, 32),
    GAUSSIANS: (1, 100_000_000),
    SAMPLES: (1, MOST_SPP),
}
_WORDS = {DENOISING: (DENOISED, RAW), FRAME_PRECISION: (HALF, SINGLE)}


def parsed(given: Sequence[str]) -> dict[str, Value]:
    """Values by name, from texts such as "degree=0".

    Raises:
        UserError: there is no such item, or it cannot have that value.
    """
    found: dict[str, Value] = {}
    for text in given:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise UserError(f"--set {text}: must be NAME=VALUE")
        found[name] = _value(name, value)
    return found


def _value(name: str, value: str) -> Value:
    if name in _NUMBERS:
        least, most = _NUMBERS[name]
        if not value.isascii() or not value.isdigit() or not least <= int(value[:12]) <= most:
            raise UserError(f"--set {name}={value}: must be a whole number from {least} to {most}")
        return int(value)
    if name in _WORDS:
        if value not in _WORDS[name]:
            raise UserError(f"--set {name}={value}: must be {' or '.join(_WORDS[name])}")
        return value
    names = ", ".join((*_NUMBERS, *_WORDS))
    raise UserError(f"--set {name}={value}: must be one of {names}; the scene decides all else")


def overridden(plan: ScenePlan, values: Mapping[str, Value]) -> ScenePlan:
    """A plan with some decisions taken by the user; those have no gain that anybody knows."""
    decisions = [
        _by_user(decision, values[decision.name]) if decision.name in values else decision
        for decision in plan.decisions
    ]
    return replace(plan, decisions=tuple(decisions))


def _by_user(decision: Decision, value: Value) -> Decision:
    return replace(decision, value=value, evidence={"planned": decision.value, **decision.evidence}, gain=1.0)
