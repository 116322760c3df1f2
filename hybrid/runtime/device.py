"""Where the splats' arrays live: on the device that Mitsuba was selected for."""

from __future__ import annotations

import mitsuba as mi

from splat.base.arrays import Arrays


def device_arrays() -> Arrays:
    """Array types of the backend in use; `select_backend` must have been called."""
    return Arrays("cuda" if str(mi.variant()).startswith("cuda") else "llvm")
