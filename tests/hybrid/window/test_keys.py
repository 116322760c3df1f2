"""What keys do once, and while they are held."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.window.key_bindings import COMMANDS, HELP, Command, HeldKeys, Walker
from hybrid.window.messages import ShownView
from tests.hybrid.window.fakes import CAMERA


def moved(*keys: str, seconds: float = 0.5) -> Walker:
    """A viewer after keys were held, in a scene whose things are two units away."""
    held, walker = HeldKeys(0.0), Walker(CAMERA)
    for key in keys:
        assert held.press(key, 0.0)
    held.move(walker, 2.0, seconds)
    return walker


@pytest.mark.parametrize(
    ("key", "way"),
    [
        ("w", (0, 0, 1)),
        ("s", (0, 0, -1)),
        ("a", (-1, 0, 0)),
        ("d", (1, 0, 0)),
        ("q", (0, 1, 0)),
        ("e", (0, -1, 0)),
    ],
)
def test_walking_covers_a_third_of_the_distance_in_a_second(key, way):
    # 0.3 of two units, for half a second; the camera's axes are right, down and forward.
    assert moved(key).camera(320, 240).position == pytest.approx(0.3 * np.array(way))


@pytest.mark.parametrize(
    ("key", "axis", "sign"),
    [("ArrowLeft", 0, -1), ("ArrowRight", 0, 1), ("ArrowUp", 1, -1), ("ArrowDown", 1, 1)],
)
def test_arrows_turn_by_sixty_degrees_in_a_second(key, axis, sign):
    forward = moved(key).camera(320, 240).camera_to_world[:3, 2]
    assert forward[axis] == pytest.approx(sign * 0.5)
    assert forward[2] == pytest.approx(np.cos(np.radians(30)))


def test_keys_that_are_held_together_add_up():
    position = moved("w", "d").camera(320, 240).position
    assert position == pytest.approx([0.3, 0, 0.3])


def test_only_held_keys_move():
    held, walker = HeldKeys(0.0), Walker(CAMERA)
    held.press("w", 0.0)
    held.press("ArrowLeft", 0.0)
    assert held
    held.discard("w")
    held.discard("r")
    assert held
    held.clear()
    assert not held
    held.move(walker, 2.0, 1.0)
    assert walker.camera(320, 240) == CAMERA


def test_time_counts_from_the_last_call_or_from_the_press_of_a_key():
    held = HeldKeys(10.0)
    assert held.elapsed(10.5) == 0.5
    assert held.elapsed(12.0) == 1.5
    held.press("w", 20.0)
    # Repeated by the keyboard while it is held.
    held.press("w", 20.2)
    assert held.elapsed(20.25) == 0.25


def test_other_keys_are_not_held():
    held = HeldKeys(0.0)
    assert not held.press("r", 0.0)
    assert not held.press("", 0.0)
    assert not held


def test_every_command_and_every_view_has_a_key_and_a_line_of_help():
    assert set(COMMANDS.values()) == {*Command, *ShownView}
    assert [COMMANDS[str(1 + number)] for number in range(len(ShownView))] == list(ShownView)
    lines = {line[:14].rstrip(): line[14:] for line in HELP}
    assert {what.value for what in (*Command, *ShownView)} < set(lines.values())
    assert (lines["Space"], lines["7"], lines["Escape"]) == (
        Command.HOLD.value,
        ShownView.DIFFERENCE.value,
        Command.LEAVE.value,
    )
    assert {"mouse", "drag, arrows", "W A S D", "Q E"} < set(lines)
    assert not {"w", "a", "s", "d", "q", "e"} & set(COMMANDS)
