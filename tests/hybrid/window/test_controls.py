"""What is chosen with the controls is a valid setting at every moment; the time of what moves."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from compose.eye.acuity import ACUITY_MODELS
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.controls import Controls, Playback
from hybrid.window.messages import ShownView

INITIAL = FrameSettings(fov_a=15.0, fov_b=11.0, spp=1)


def test_initial_settings_are_exact_until_something_is_changed():
    asked = FrameSettings(
        fov_a=12.4, fov_b=11.25, spp=32, acuity_model="fov-gs", rate=1, scale=0.5, display="hmd"
    )
    controls = Controls(asked, 24.5, 4)
    assert controls.settings() == asked
    assert controls.target_fps == 24.5
    controls.set("acuity model", list(ACUITY_MODELS).index("none"))
    assert controls.settings().acuity_model == "none"
    assert controls.target_fps == 24
    # What no control changes.
    assert controls.settings().display == asked.display


def test_what_was_not_changed_stays_when_something_else_is():
    asked = FrameSettings(fov_a=12.4, fov_b=11.2, spp=3, acuity_model="fov-gs", rate=1, scale=0.5)
    controls = Controls(asked, None, 4)
    assert controls.values["target"] == 15
    controls.set("samples", 2)
    # Sliders know whole numbers only.
    assert controls.settings() == replace(asked, fov_a=12.0, fov_b=11.0, spp=2)


def test_controls_reach_as_far_as_frames_are_useful():
    ends = {one.name: (one.low, one.high) for one in Controls(INITIAL, None, 4).all}
    assert ends["fov-a"] == ends["fov-b"] == (0, 75)
    assert ends["samples"] == (1, 16)
    assert ends["coarsest layer"] == ends["finest layer"] == (1, 4)
    assert (ends["finest rate"], ends["scale"], ends["target"]) == ((0, 3), (25, 100), (1, 120))


def test_initial_layers_are_kept():
    controls = Controls(replace(INITIAL, layers=(2, 3)), None, 4)
    assert (controls.values["coarsest layer"], controls.values["finest layer"]) == (2, 3)
    assert controls.settings().layers == (2, 3)


def test_another_number_of_layers_leaves_what_is_chosen():
    controls = Controls(INITIAL, None, 1)
    for layers in (4, 2):
        controls.set_layers(layers)
        assert controls.values["finest layer"] == layers
        assert controls.settings() == INITIAL
    controls.set_layers(4)
    controls.set("finest layer", 3)
    controls.set("coarsest layer", 3)
    assert controls.settings().layers == (3, 3)
    controls.set_layers(2)
    assert controls.settings().layers == (2, 2)
    with pytest.raises(ValueError, match="finest layer"):
        controls.set("finest layer", 3)


def test_each_control_sets_what_it_names():
    controls = Controls(INITIAL, None, 4)
    controls.set("fov-a", 40)
    controls.set("fov-b", 30)
    controls.set("samples", 3)
    controls.set("acuity model", list(ACUITY_MODELS).index("fov-gs"))
    controls.set("coarsest layer", 2)
    controls.set("finest layer", 3)
    controls.set("finest rate", 2)
    controls.set("scale", 50)
    expected = FrameSettings(
        fov_a=40.0, fov_b=30.0, spp=3, acuity_model="fov-gs", layers=(2, 3), rate=2, scale=0.5
    )
    assert controls.settings() == expected
    assert controls.target_fps is None
    controls.set("keep FPS", 1)
    controls.set("target", 30)
    assert controls.target_fps == 30
    assert controls.view is ShownView.COMPOSITE
    controls.set("view", 5)
    assert controls.view is ShownView.LEVELS


def test_lists_hold_all_views_and_acuity_models():
    entries = {one.name: one.entries for one in Controls(INITIAL, None, 4).all if one.kind == "list"}
    assert entries == {
        "view": tuple(view.value for view in ShownView),
        "acuity model": tuple(ACUITY_MODELS),
    }


def test_labels_show_the_values():
    controls = Controls(INITIAL, None, 4)
    controls.set("fov-a", 40)
    texts = {controls.text(one) for one in controls.all}
    assert {"fov-a 40 %", "fov-b 11 %", "samples 1", "finest layer 4", "scale 100 %", "acuity model"} <= texts


def test_the_ends_of_a_range_push_each_other():
    controls = Controls(INITIAL, None, 4)
    controls.set("fov-a", 5)
    assert controls.values["fov-b"] == 5
    controls.set("fov-b", 50)
    assert controls.values["fov-a"] == 50
    controls.set("finest layer", 2)
    controls.set("coarsest layer", 3)
    assert controls.values["finest layer"] == 3
    controls.set("finest layer", 1)
    assert controls.values["coarsest layer"] == 1


def test_settings_are_the_same_object_until_one_changes():
    controls = Controls(INITIAL, None, 4)
    first = controls.settings()
    assert controls.settings() is first
    controls.set("samples", 2)
    second = controls.settings()
    assert second is not first
    assert controls.settings() is second


def test_every_choice_is_a_valid_setting():
    # FrameSettings checks all values but the order of the layers.
    controls, chance = Controls(INITIAL, None, 4), random.Random(3)
    found = set()
    for _ in range(300):
        control = chance.choice(controls.all)
        controls.set(control.name, chance.randint(control.low, control.high))
        settings = controls.settings()
        low, high = settings.layers or (1, 4)
        assert low <= high
        found.add(settings)
    assert len(found) > 150


@pytest.mark.parametrize(
    ("name", "value"),
    [("samples", 0), ("samples", 17), ("view", 7), ("keep FPS", 2), ("samples", 1.0), ("play", 1), ("", 1)],
)
def test_other_values_are_refused(name, value):
    controls = Controls(INITIAL, None, 4)
    before = dict(controls.values)
    with pytest.raises(ValueError, match=f"control '{name}'"):
        controls.set(name, value)
    assert controls.values == before


def test_what_the_controller_chooses_cannot_be_chosen_by_hand():
    controls = Controls(INITIAL, 15.0, 4)
    chosen = "samples", "coarsest layer", "finest layer", "finest rate", "scale"
    assert not any(controls.is_enabled(name) for name in chosen)
    assert controls.is_enabled("fov-a")
    controls.set("keep FPS", 0)
    assert all(controls.is_enabled(name) for name in chosen)
    assert controls.target_fps is None


def test_a_scene_that_moves_has_controls_of_its_time():
    playback = Playback(4.0)
    controls = Controls(INITIAL, None, 4, playback)
    controls.set("play", 1)
    controls.set("speed", 1)
    assert (playback.playing, playback.speed) == (True, 0.25)
    controls.set("play", 0)
    assert not playback.playing
    controls.set("time", 430)
    assert playback.at(0.0) == pytest.approx(0.43)
    # What is shown is not sought: it may be between two steps.
    playback.seek(0.12345)
    controls.show_time(0.12345)
    assert controls.values["time"] == 123
    assert playback.at(0.0) == 0.12345
    assert "time 0.12" in {controls.text(one) for one in controls.all}
    assert controls.settings() == INITIAL
    assert not {"play", "speed", "time"} & set(Controls(INITIAL, None, 4).values)


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
