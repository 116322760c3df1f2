"""What a region and a scene take."""

from __future__ import annotations

from dataclasses import dataclass

# What there is to model grows with this power of the views that a region takes: some surfaces take many views
# to be seen at all, behind and between things.
_SURFACES = 0.7
# The same with the share of the frames that shows edges and texture, within a range that was tried: fewer
# Gaussians than 0.6 times those of `room` show in shades that no edge or texture tells of.
_DETAIL, _LEAST_DETAIL, _MOST_DETAIL = 0.7, 0.6, 1.5


@dataclass(frozen=True)
class Needs:
    """What a region and a scene take, over what the default region of `room` takes.

    Attributes:
        breadth: views of the region until little is unseen.
        detail: Gaussians for equal breadth.
    """

    breadth: float = 1.0
    detail: float = 1.0

    @staticmethod
    def of(breadth: float, complexity: float) -> Needs:
        """As the breadth of a region and the complexity of its frames (hybrid.plan.complexity) tell."""
        return Needs(breadth, min(max(complexity**_DETAIL, _LEAST_DETAIL), _MOST_DETAIL))

    @property
    def gaussians(self) -> float:
        """Gaussians that they take."""
        return self.breadth**_SURFACES * self.detail
