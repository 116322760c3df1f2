"""How a fovea is made."""

from __future__ import annotations

from compose.base.errors import UserError

MODES = ("raw", "denoised", "fused")


def mode_named(name: str) -> str:
    """The name of a way to make the fovea, checked.

    Raises:
        UserError: there is no such way.
    """
    if name not in MODES:
        raise UserError(f"--fovea {name}: must be {', '.join(MODES[:-1])} or {MODES[-1]}")
    return name
