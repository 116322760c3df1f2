"""The device on which the splats' arrays live: the one that Mitsuba uses."""

from __future__ import annotations

import mitsuba as mi

from compose.base.arrays import Arrays


def device_arrays() -> Arrays:
    """Array types of the selected backend; requires that `select_backend` has been called."""
    return Arrays("cuda" if str(mi.variant()).startswith("cuda") else "llvm")
