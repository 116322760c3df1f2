"""Keys of the window: what each one does, and walking while some of them are held."""

from __future__ import annotations

from enum import Enum

from PySide6.QtCore import Qt

from hybrid.window.messages import ShownView
from hybrid.window.navigation import Walker

_Key = Qt.Key
# Right, down and forward.
_WALK = {
    _Key.Key_W: (0, 0, 1),
    _Key.Key_S: (0, 0, -1),
    _Key.Key_A: (-1, 0, 0),
    _Key.Key_D: (1, 0, 0),
    _Key.Key_Q: (0, 1, 0),
    _Key.Key_E: (0, -1, 0),
}
# Right and down.
_LOOK = {_Key.Key_Left: (-1, 0), _Key.Key_Right: (1, 0), _Key.Key_Up: (0, -1), _Key.Key_Down: (0, 1)}
# Walking speed in median distances per second, and turning speed in degrees per second.
_PACE, _TURN = 0.3, 60.0


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
    LEAVE = "leave full screen, or close the window"


COMMANDS: dict[int, Command | ShownView] = {
    _Key.Key_Space: Command.HOLD,
    _Key.Key_R: Command.HOME,
    **{_Key(_Key.Key_1 + number): view for number, view in enumerate(ShownView)},
    _Key.Key_P: Command.SAVE,
    _Key.Key_T: Command.RECORD,
    _Key.Key_M: Command.PLAY,
    _Key.Key_G: Command.RING,
    _Key.Key_H: Command.HUD,
    _Key.Key_Tab: Command.CONTROLS,
    _Key.Key_F: Command.FULL_SCREEN,
    _Key.Key_F1: Command.HELP,
    _Key.Key_Escape: Command.LEAVE,
}

_HELP = {
    "mouse": "move the gaze",
    "drag, arrows": "look around",
    "W A S D": "walk",
    "Q E": "move down, up",
    **{_Key(key).name.removeprefix("Key_"): command.value for key, command in COMMANDS.items()},
}
HELP = [f"{keys:<14}{effect}" for keys, effect in _HELP.items()]


class HeldKeys(set[int]):
    """Keys that walk or look around for as long as they are held; times are seconds on one clock."""

    def __init__(self, now: float):
        super().__init__()
        self._before = now

    def press(self, key: int, now: float) -> bool:
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
                walker.walk(*(step * way for way in _WALK[_Key(key)]))
            else:
                walker.look(*(_TURN * seconds * way for way in _LOOK[_Key(key)]))
