"""Keys of the window: what each one does, and walking through the scene while some of them are held.

Keys have the names that browsers give them (`KeyboardEvent.key`), letters in lower case.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from compose.camera.camera import Array, Camera, turned
from hybrid.window.messages import ShownView

# Right, down and forward.
_WALK = {"w": (0, 0, 1), "s": (0, 0, -1), "a": (-1, 0, 0), "d": (1, 0, 0), "q": (0, 1, 0), "e": (0, -1, 0)}
# Right and down.
_LOOK = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowUp": (0, -1), "ArrowDown": (0, 1)}
# Walking speed in median distances per second, and turning speed in degrees per second.
_PACE, _TURN = 0.3, 60.0
# Steepest look up or down, in degrees.
_MOST_PITCH = 85.0


class Command(Enum):
    """What a key does once; the values are the help texts."""

    HOLD = "hold the gaze; again: release it"
    HOME = "return to the scene's own camera"
    SAVE = "screenshot as PNG, its AOVs as EXR"
    RECORD = "record the gaze; again: save it as CSV"
    PLAY = "play a scene that moves; again: pause it"
    RING = "ring around the disc"
    HUD = "frame times"
    CONTROLS = "controls"
    FULL_SCREEN = "full screen"
    HELP = "this help"
    LEAVE = "leave full screen; if not in a browser, close the window"


# What concerns the window itself: shells do it.
OF_THE_SHELL = (Command.FULL_SCREEN, Command.LEAVE)
COMMANDS: dict[str, Command | ShownView] = {
    " ": Command.HOLD,
    "r": Command.HOME,
    **{str(1 + number): view for number, view in enumerate(ShownView)},
    "p": Command.SAVE,
    "t": Command.RECORD,
    "m": Command.PLAY,
    "g": Command.RING,
    "h": Command.HUD,
    "Tab": Command.CONTROLS,
    "f": Command.FULL_SCREEN,
    "F1": Command.HELP,
    "Escape": Command.LEAVE,
}

_HELP = {
    "mouse": "move the gaze",
    "drag, arrows": "look around",
    "W A S D": "walk",
    "Q E": "move down, up",
    **{"Space" if key == " " else key.capitalize(): command.value for key, command in COMMANDS.items()},
}
HELP = [f"{keys:<14}{effect}" for keys, effect in _HELP.items()]


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


class HeldKeys(set[str]):
    """Keys that walk or look around for as long as they are held; times are seconds on one clock."""

    def __init__(self, now: float):
        super().__init__()
        self._before = now

    def press(self, key: str, now: float) -> bool:
        """Notes that a key is pressed, if it walks or looks around; whether it does."""
        if key not in _WALK and key not in _LOOK:
            return False
        if key not in self:
            self._before = now
        self.add(key)
        return True

    def elapsed(self, now: float) -> float:
        """Seconds since the last call, or since a key was pressed."""
        seconds, self._before = now - self._before, now
        return seconds

    def move(self, walker: Walker, distance: float, seconds: float) -> None:
        """Walks and looks around for some seconds; the pace is in median distances to what is visible."""
        for key in self:
            if key in _WALK:
                step = _PACE * distance * seconds
                walker.walk(*(step * way for way in _WALK[key]))
            else:
                walker.look(*(_TURN * seconds * way for way in _LOOK[key]))
