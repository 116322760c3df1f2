"""Moving through a scene: walking and looking around with the horizon level, and the time of what moves."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Array, Camera, turned

# Steepest look up or down, in degrees.
_MOST_PITCH = 85.0


class Walker:
    """A viewer who starts at a home camera, whose upward axis stays upward."""

    def __init__(self, home: Camera):
        self._home = home
        self.reset()

    def reset(self) -> None:
        """Returns to where the walk began."""
        self._offset: Array = np.zeros(3)
        self._yaw = self._pitch = 0.0
        self._view: Camera | None = None

    def look(self, right: float, down: float) -> None:
        """Turns by angles in degrees."""
        self._view = None
        self._yaw += right
        self._pitch = float(np.clip(self._pitch + down, -_MOST_PITCH, _MOST_PITCH))

    def walk(self, right: float, down: float, forward: float) -> None:
        """Moves along the axes of the view, in units of the scene."""
        self._view = None
        self._offset = self._offset + self._rotation() @ np.array([right, down, forward])

    def camera(self, width: int, height: int) -> Camera:
        """The view in a frame of that many pixels; the same object as long as nothing moves."""
        if self._view is None or (self._view.width, self._view.height) != (width, height):
            self._view = self._home.resized(width, height)
            if self._offset.any() or self._yaw or self._pitch:
                pose = np.eye(4)
                pose[:3, :3] = self._rotation()
                pose[:3, 3] = self._home.position + self._offset
                self._view = self._view.at(pose)
        return self._view

    def _rotation(self) -> Array:
        """(3, 3) camera-to-world rotation of the view."""
        return turned(self._home.camera_to_world[:3, :3], self._yaw, -self._pitch)


class Playback:
    """Time of a scene, which goes from 0 to 1 in the given seconds if its speed is 1, while it is playing."""

    def __init__(self, seconds: float):
        self._seconds, self._time, self._before = seconds, 0.0, 0.0
        self.playing, self.speed = False, 1.0

    def at(self, now: float) -> float:
        """The time at `now`, in seconds of a clock that does not go back; after 1 comes 0."""
        if self.playing:
            self._time = (self._time + (now - self._before) * self.speed / self._seconds) % 1
        self._before = now
        return self._time

    def seek(self, time: float) -> None:
        """Goes to a time from 0 to 1."""
        self._time = time
