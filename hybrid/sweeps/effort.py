"""How much a sweep measures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Effort:
    """How much a sweep measures.

    Attributes:
        repeats: measured frames per row.
        warm_up: frames before that, which are not measured.
        reference_spp: samples per pixel of the references.
    """

    repeats: int
    warm_up: int
    reference_spp: int
