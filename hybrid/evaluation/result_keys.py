"""Names in the results of an evaluation: methods, budgets, metrics, and the images in its folder."""

from __future__ import annotations

from typing import Any, NamedTuple

# The method whose rays and time the baselines get.
OURS = "hybrid, fused"
# The name under which the quality of a reference itself is reported: half of its samples against the other.
HALVES = "reference, half against half"
# In what a method was made equal to OURS; FIXED for in nothing.
EQUAL_RAYS, EQUAL_TIME, FIXED = "equal-rays", "equal-time", "fixed"


class Key(NamedTuple):
    """What identifies a method's results: its name and its budget, EQUAL_RAYS, EQUAL_TIME or FIXED."""

    method: str
    budget: str

    @staticmethod
    def of(row: dict[str, Any]) -> Key:
        """The key of a row of results."""
        return Key(row["method"], row["budget"])

    @property
    def label(self) -> str:
        """The method as it is named in lists."""
        return self.method if self.budget == FIXED else f"{self.method} ({self.budget})"


OURS_KEY, HALVES_KEY = Key(OURS, FIXED), Key(HALVES, FIXED)


def half_name(metric: str, number: int) -> str:
    """Name of a metric against the first or the second half of a reference's samples."""
    return f"{metric}, half {number}"


def image_name(view: int, key: Key | None) -> str:
    """File name of the frame of a method and budget in a view; of the reference if None."""
    name = "reference" if key is None else "-".join(key)
    return f"{view}-{name}.png".replace(",", "").replace(" ", "-")


def flip_name(view: int, key: Key) -> str:
    """File name of a frame's FLIP map."""
    return image_name(view, key).replace(".png", "-flip.png")
