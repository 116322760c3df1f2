"""One decision of a plan, with the numbers behind it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

Value = int | float | str | bool


@dataclass(frozen=True)
class Decision:
    """What a scene requires of one part of the renderers.

    Attributes:
        name: of the part.
        value: what is decided.
        fixed: what would be taken for a scene that nobody has looked at.
        evidence: the numbers that decide, by name.
        gain: how many times less `of` there is than with the fixed value; 1 for as much.
        of: what the gain counts, such as "time per path".
    """

    name: str
    value: Value
    fixed: Value
    evidence: dict[str, Any]
    gain: float
    of: str

    def row(self) -> dict[str, Any]:
        """As `hybrid plan --json` writes it."""
        return asdict(self)
