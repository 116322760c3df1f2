"""What a region and a scene take."""

from __future__ import annotations

from dataclasses import dataclass

# What there is to model grows with this power of the views that a region takes: some surfaces take many views
# to be seen at all, behind and between things.
_SURFACES = 0.7
# The same with the share of the frames that shows edges and texture, within a range that was tried.
_DETAIL, _LEAST_GAUSSIANS, _MOST_GAUSSIANS = 0.7, 0.25, 1.5


@dataclass(frozen=True)
class Needs:
    """What a region and a scene take, over what the default region of `room` takes.

    Attributes:
        breadth: views of the region until little is unseen.
        complexity: share of the frames that shows edges and texture; 1 before there are frames.
    """

    breadth: float = 1.0
    complexity: float = 1.0

    @property
    def gaussians(self) -> float:
        """Gaussians that they take."""
        detail = min(max(self.complexity**_DETAIL, _LEAST_GAUSSIANS), _MOST_GAUSSIANS)
        return self.breadth**_SURFACES * detail
