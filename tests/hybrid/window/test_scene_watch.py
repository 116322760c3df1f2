"""Changes of a scene's files are noticed once they are complete."""

from __future__ import annotations

import os

import pytest

from hybrid.window import learning
from hybrid.window.learning import SceneWatch
from tests.extremes import extreme

SCENE = '<scene version="3.0.0"><string name="filename" value="{}"/></scene>'


@pytest.fixture
def watched(tmp_path, monkeypatch):
    """A scene's file, and what looks at it each time it is asked."""
    monkeypatch.setattr(learning, "_LOOK_EVERY", 0.0)
    (tmp_path / "a.obj").write_text("a")
    (tmp_path / "b.obj").write_text("b")
    file = tmp_path / "scene.xml"
    file.write_text(SCENE.format("a.obj"))
    return file, SceneWatch(file)


def looks(watch: SceneWatch) -> list[bool]:
    return [watch.changed() for _ in range(3)]


def test_a_changed_file_is_noticed_once(watched):
    file, watch = watched
    assert not any(looks(watch))
    file.with_name("a.obj").write_text("changed")
    # At first, it may still be being written.
    assert looks(watch) == [False, True, False]


def test_a_file_of_the_same_size_is_noticed_by_its_time(watched):
    file, watch = watched
    os.utime(file, ns=(1, 1))
    assert looks(watch) == [False, True, False]


def test_files_that_the_scene_does_not_name_do_not_matter(watched):
    file, watch = watched
    file.with_name("b.obj").write_text("changed")
    assert not any(looks(watch))
    file.write_text(SCENE.format("b.obj"))
    assert looks(watch) == [False, True, False]
    file.with_name("b.obj").write_text("changed again")
    assert looks(watch) == [False, True, False]


@extreme(
    "a scene's file that is half written, then gone",
    given="a window that watches it",
    expected="nothing until it can be read again",
)
def test_a_file_that_cannot_be_read_is_waited_for(watched, got):
    file, watch = watched
    file.write_text("<scene")
    assert not any(looks(watch))
    file.unlink()
    assert not any(looks(watch))
    file.write_text(SCENE.format("a.obj") + " ")
    assert looks(watch) == [False, True, False]
    got("waited for")


def test_it_does_not_look_all_the_time(watched, monkeypatch):
    file, watch = watched
    monkeypatch.setattr(learning, "_LOOK_EVERY", 1000.0)
    file.with_name("a.obj").write_text("changed")
    assert not any(looks(watch))
