"""What is chosen with the controls is a valid setting at every moment."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel, QSlider, QWidget

from compose.eye.acuity import ACUITY_MODELS
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.messages import ShownView
from hybrid.window.navigation import Playback
from hybrid.window.panel import Panel

pytestmark = pytest.mark.usefixtures("application")
INITIAL = FrameSettings(fov_a=15.0, fov_b=11.0, spp=1)


def test_initial_settings_are_exact_until_something_is_changed():
    asked = FrameSettings(
        fov_a=12.4, fov_b=11.25, spp=32, acuity_model="fov-gs", rate=1, scale=0.5, display="hmd"
    )
    panel = Panel(asked, 24.5, 4)
    assert panel.settings() == replace(asked, layers=(1, 4))
    assert panel.target_fps == 24.5
    panel.acuity_model.setCurrentText("none")
    assert panel.settings().acuity_model == "none"
    assert panel.target_fps == 24
    # What no control changes.
    assert panel.settings().display == asked.display


def test_what_was_not_changed_stays_when_something_else_is():
    asked = FrameSettings(fov_a=12.4, fov_b=11.2, spp=3, acuity_model="fov-gs", rate=1, scale=0.5)
    panel = Panel(asked, None, 4)
    assert panel.target.value() == 15
    panel.spp.setValue(2)
    # Sliders know whole numbers only.
    assert panel.settings() == replace(asked, fov_a=12.0, fov_b=11.0, spp=2, layers=(1, 4))


def test_controls_reach_as_far_as_frames_are_useful():
    panel = Panel(INITIAL, None, 4)
    for control, low, high in (
        (panel.fov_a, 0, 75),
        (panel.spp, 1, 16),
        (panel.coarsest, 1, 4),
        (panel.rate, 0, 3),
        (panel.scale, 25, 100),
        (panel.target, 1, 120),
    ):
        assert (control.minimum(), control.maximum()) == (low, high)
        assert panel.isAncestorOf(control)


def test_initial_layers_are_kept():
    panel = Panel(replace(INITIAL, layers=(2, 3)), None, 4)
    assert (panel.coarsest.value(), panel.finest.value()) == (2, 3)
    assert panel.settings().layers == (2, 3)


def test_each_control_sets_what_it_names():
    panel = Panel(INITIAL, None, 4)
    panel.fov_a.setValue(40)
    panel.fov_b.setValue(30)
    panel.spp.setValue(3)
    panel.acuity_model.setCurrentText("fov-gs")
    panel.coarsest.setValue(2)
    panel.finest.setValue(3)
    panel.rate.setValue(2)
    panel.scale.setValue(50)
    expected = FrameSettings(
        fov_a=40.0, fov_b=30.0, spp=3, acuity_model="fov-gs", layers=(2, 3), rate=2, scale=0.5
    )
    assert panel.settings() == expected
    assert panel.target_fps is None
    panel.controlled.setChecked(True)
    panel.target.setValue(30)
    assert panel.target_fps == 30
    assert panel.view is ShownView.COMPOSITE
    panel.views.setCurrentIndex(5)
    assert panel.view is ShownView.LEVELS


def test_lists_hold_all_views_and_acuity_models():
    panel = Panel(INITIAL, None, 4)
    assert [panel.views.itemText(i) for i in range(panel.views.count())] == [view.value for view in ShownView]
    assert panel.acuity_model.count() == len(ACUITY_MODELS)


def test_labels_show_the_values():
    panel = Panel(INITIAL, None, 4)
    panel.fov_a.setValue(40)
    texts = {label.text() for label in panel.findChildren(QLabel)}
    assert {"fov-a 40 %", "fov-b 11 %", "samples 1", "finest layer 4", "scale 100 %", "acuity model"} <= texts


def test_the_ends_of_a_range_push_each_other():
    panel = Panel(INITIAL, None, 4)
    panel.fov_a.setValue(5)
    assert panel.fov_b.value() == 5
    panel.fov_b.setValue(50)
    assert panel.fov_a.value() == 50
    panel.finest.setValue(2)
    panel.coarsest.setValue(3)
    assert panel.finest.value() == 3
    panel.finest.setValue(1)
    assert panel.coarsest.value() == 1


def test_settings_are_the_same_object_until_one_changes():
    panel = Panel(INITIAL, None, 4)
    first = panel.settings()
    assert panel.settings() is first
    panel.spp.setValue(2)
    second = panel.settings()
    assert second is not first
    assert panel.settings() is second


def test_every_setting_that_anyone_hears_of_is_valid():
    # FrameSettings checks all values but the order of the layers.
    panel, chance = Panel(INITIAL, None, 4), random.Random(3)
    heard: list[FrameSettings] = []
    panel.changed.connect(lambda: heard.append(panel.settings()))
    sliders = panel.findChildren(QSlider)
    assert len(sliders) == 7
    for _ in range(300):
        slider = chance.choice(sliders)
        slider.setValue(chance.randint(slider.minimum(), slider.maximum()))
    assert len(heard) > 250
    assert all(settings.layers and settings.layers[0] <= settings.layers[1] for settings in heard)
    assert len(set(heard)) > 200


def test_every_change_is_heard():
    panel = Panel(INITIAL, None, 4)
    heard: list[None] = []
    panel.changed.connect(lambda: heard.append(None))
    for change in (
        lambda: panel.views.setCurrentIndex(1),
        lambda: panel.controlled.setChecked(True),
        lambda: panel.target.setValue(31),
        lambda: panel.scale.setValue(70),
    ):
        before = len(heard)
        change()
        assert len(heard) == before + 1


def test_what_the_controller_chooses_cannot_be_chosen_by_hand():
    panel = Panel(INITIAL, 15.0, 4)
    chosen = panel.spp, panel.coarsest, panel.finest, panel.rate, panel.scale
    assert not any(control.isEnabled() for control in chosen)
    assert panel.fov_a.isEnabled()
    panel.controlled.setChecked(False)
    assert all(control.isEnabled() for control in chosen)
    assert panel.target_fps is None


def test_no_control_takes_keys_from_the_frame():
    panel = Panel(INITIAL, None, 4)
    policies = {control.focusPolicy() for control in panel.findChildren(QWidget)}
    assert policies == {Qt.FocusPolicy.NoFocus}


def test_a_scene_that_moves_has_controls_of_its_time():
    playback = Playback(4.0)
    panel = Panel(INITIAL, None, 4, playback)
    heard: list[None] = []
    panel.changed.connect(lambda: heard.append(None))
    assert panel.play is not None
    panel.play.setChecked(True)
    panel.speed.setCurrentText("0.25 x")
    assert (playback.playing, playback.speed) == (True, 0.25)
    panel.play.setChecked(False)
    assert not playback.playing
    panel.time.setValue(430)
    assert playback.at(0.0) == pytest.approx(0.43)
    # What is shown is not sought: it may be between two steps.
    playback.seek(0.12345)
    panel.show_time(0.12345)
    assert panel.time.value() == 123
    assert playback.at(0.0) == 0.12345
    assert any(label.text() == "time 0.12" for label in panel.findChildren(QLabel))
    assert not heard
    assert panel.settings() == replace(INITIAL, layers=(1, 4))
    assert Panel(INITIAL, None, 4).play is None
