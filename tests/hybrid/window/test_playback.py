"""The time of a scene that plays."""

from __future__ import annotations

import pytest

from hybrid.window.controls import Playback


def test_time_passes_while_it_plays_and_begins_anew():
    playback = Playback(4.0)
    assert playback.at(100.0) == 0
    assert playback.at(103.0) == 0
    playback.playing = True
    assert playback.at(104.0) == pytest.approx(0.25)
    assert playback.at(106.0) == pytest.approx(0.75)
    assert playback.at(108.0) == pytest.approx(0.25)
    playback.playing = False
    assert playback.at(109.0) == pytest.approx(0.25)


def test_a_pause_is_not_made_up_for():
    playback = Playback(10.0)
    playback.at(0.0)
    playback.playing = True
    playback.at(1.0)
    playback.playing = False
    playback.at(50.0)
    playback.playing = True
    assert playback.at(51.0) == pytest.approx(0.2)


def test_speed_and_seeking():
    playback = Playback(2.0)
    playback.at(0.0)
    playback.playing, playback.speed = True, 0.5
    assert playback.at(1.0) == pytest.approx(0.25)
    playback.seek(0.9)
    assert playback.at(1.0) == pytest.approx(0.9)
    assert playback.at(1.2) == pytest.approx(0.95)
