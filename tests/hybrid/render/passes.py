"""Names of the passes of a frame."""

from __future__ import annotations

from hybrid.base.compute_device import device_arrays


def waits() -> list[str]:
    """What comes after all passes: on a card, waiting for it."""
    return ["device"] if device_arrays().backend == "cuda" else []
