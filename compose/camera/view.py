"""A view of a scene at a time."""

from __future__ import annotations

from dataclasses import dataclass, replace

from compose.camera.camera import Camera


@dataclass(frozen=True)
class View:
    """What a frame shows.

    Attributes:
        camera: from where.
        time: when, from 0 to 1; 0 in a scene that stands still.
    """

    camera: Camera
    time: float = 0.0

    def resized(self, width: int, height: int) -> View:
        """The same view at another size."""
        return replace(self, camera=self.camera.resized(width, height))

    @property
    def key(self) -> bytes:
        """Equal for equal views."""
        return self.camera.key + (b"" if self.time == 0 else repr(self.time).encode())
