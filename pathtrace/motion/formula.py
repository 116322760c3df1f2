"""Closed formulas of where vertices are: arithmetic of x, y, z and t, and nothing else."""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": np.sin,
    "cos": np.cos,
    "exp": np.exp,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "min": np.minimum,
    "max": np.maximum,
}
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
}
_TWO_ARGUMENTS = {"min", "max"}
_NAMES = {"x", "y", "z", "t", "pi"}
# Longer ones are no closed formulas, and nest deeper than Python can follow.
_MOST_CHARACTERS = 1000


@dataclass(frozen=True)
class Formula:
    """Three expressions of a vertex' rest position x, y, z and the time t.

    Attributes:
        texts: of the new x, y and z, in Python's notation: numbers, + - * / **, parentheses, pi, and sin,
            cos, exp, sqrt, abs, min and max.

    Raises:
        ValueError: an expression holds anything else.
    """

    texts: tuple[str, str, str]

    def __post_init__(self) -> None:
        for text in self.texts:
            _require_closed(_parsed(text))

    def positions(self, rest: Array, time: float) -> Array:
        """Positions (N, 3) at a time of vertices whose rest positions are (N, 3).

        Raises:
            ValueError: a position is not finite.
        """
        values = {**dict(zip("xyz", rest.T, strict=True)), "t": time, "pi": np.pi}
        with np.errstate(all="ignore"):
            columns = [np.broadcast_to(_value(_parsed(text), values), len(rest)) for text in self.texts]
        found = np.stack(columns, axis=1).astype(np.float64)
        if not np.isfinite(found).all():
            raise ValueError(f"formula has no finite value for every vertex at t = {time:g}")
        return found


# Of a scene that plays, the same formulas are asked for many times a second.
@lru_cache
def _parsed(text: str) -> ast.expr:
    if len(text) > _MOST_CHARACTERS:
        raise ValueError(f"formula of {len(text):,} characters; must have at most {_MOST_CHARACTERS:,}")
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
        raise ValueError(f"{text!r} is no formula") from error


def _require_closed(node: ast.expr) -> None:
    """ValueError if an expression holds what a formula may not."""
    match node:
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            return
        case ast.Name(id=name) if name in _NAMES:
            return
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            _require_closed(operand)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            _require_closed(left)
            _require_closed(right)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in _FUNCTIONS:
            if len(args) != (2 if name in _TWO_ARGUMENTS else 1):
                raise ValueError(f"{name} has {len(args)} arguments in a formula")
            for argument in args:
                _require_closed(argument)
        case _:
            raise ValueError(
                f"{ast.unparse(node)!r} in a formula; may hold {', '.join(sorted(_NAMES))}, "
                f"numbers, + - * / **, {', '.join(_FUNCTIONS)}"
            )


def _value(node: ast.expr, values: dict[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return values[name]
        case ast.UnaryOp(op=op, operand=operand):
            return _OPERATORS[type(op)](_value(operand, values))
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_value(left, values), _value(right, values))
        case ast.Call(func=ast.Name(id=name), args=args):
            return _FUNCTIONS[name](*(_value(argument, values) for argument in args))
    raise AssertionError("not checked")
