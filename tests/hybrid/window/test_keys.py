"""What keys do once, and while they are held: walking and looking around."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import camera_from_pose, look_at
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


HOME = camera_from_pose(
    look_at(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.5, 0.0]), np.array([0.0, 1.0, 0.0])),
    *(64, 48, 50.0, 50.0, 32.0, 24.0),
)


def middle(walker: Walker) -> np.ndarray:
    """The direction that the middle of the frame looks at, in axes of the home camera."""
    camera = walker.camera(64, 48)
    return HOME.world_to_camera[:3, :3] @ camera.rays(np.array([[32.0, 24.0]]))[0]


def test_nothing_moves_at_home():
    walker = Walker(HOME)
    assert walker.camera(64, 48).key == HOME.key
    walker.look(10, 5)
    walker.walk(1, 1, 1)
    walker.reset()
    assert walker.camera(64, 48).key == HOME.key


def test_looking_right_and_down_turns_that_way():
    walker = Walker(HOME)
    walker.look(30, 0)
    assert middle(walker) == pytest.approx([0.5, 0, np.sqrt(0.75)])
    walker.look(-30, 20)
    assert middle(walker) == pytest.approx([0, np.sin(np.radians(20)), np.cos(np.radians(20))])


def test_one_walks_where_one_looks():
    walker = Walker(HOME)
    walker.look(90, 0)
    walker.walk(0, 0, 2)
    moved = HOME.world_to_camera[:3, :3] @ (walker.camera(64, 48).position - HOME.position)
    assert moved == pytest.approx([2, 0, 0], abs=1e-12)


def test_the_horizon_stays_level_and_nobody_turns_over():
    walker = Walker(HOME)
    for _ in range(50):
        walker.look(13, 7)
    camera = walker.camera(64, 48)
    right = HOME.world_to_camera[:3, :3] @ camera.camera_to_world[:3, 0]
    assert right[1] == pytest.approx(0, abs=1e-12)
    assert middle(walker)[1] == pytest.approx(np.sin(np.radians(85)))
    rotation = camera.camera_to_world[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_the_frame_may_have_any_size():
    walker = Walker(HOME)
    walker.look(5, 5)
    camera = walker.camera(200, 96)
    assert (camera.width, camera.height) == (200, 96)
    assert camera.vertical_fov == pytest.approx(HOME.vertical_fov)


def test_the_camera_is_the_same_object_until_something_changes():
    walker = Walker(HOME)
    changes = (
        lambda: walker.look(5, 0),
        lambda: walker.walk(0, 0, 1),
        walker.reset,
    )
    seen = [walker.camera(64, 48)]
    for change in changes:
        assert walker.camera(64, 48) is seen[-1]
        change()
        seen.append(walker.camera(64, 48))
    assert len({camera.key for camera in seen}) == 3
    assert seen[-1] == seen[0]
    assert (walker.camera(64, 50).width, walker.camera(64, 50).height) == (64, 50)
    assert (walker.camera(70, 50).width, walker.camera(70, 50).height) == (70, 50)
