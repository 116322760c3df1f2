"""Settings of an evaluation: what is refused, and what its file has of them."""

from __future__ import annotations

import json

import pytest

from compose.base.errors import UserError
from hybrid.evaluation.settings import EvaluationSettings
from hybrid.frame.settings import FrameSettings


@pytest.mark.parametrize("name", ["width", "height", "views", "reference_spp", "repeats"])
@pytest.mark.parametrize("value", [0, -2])
def test_counts_must_be_positive(name, value):
    with pytest.raises(UserError, match=f"{name.replace('_', '-')} {value}: must be positive"):
        EvaluationSettings(**{name: value})


def test_a_gaze_outside_of_the_frame_and_a_missing_disc_are_refused():
    with pytest.raises(UserError, match=r"gaze 1.5 0.5: lies outside the frame"):
        EvaluationSettings(FrameSettings(gaze=(1.5, 0.5)))
    with pytest.raises(UserError, match=r"fov-a 0.0: there is no fovea to evaluate"):
        EvaluationSettings(FrameSettings(fov_a=0, fov_b=0))


def test_evaluation_json_has_all_settings_but_the_display():
    settings = EvaluationSettings(FrameSettings((0.3, 0.6), 30, 10, 2), 64, 48, 2, 8, 5, 7)
    assert json.loads(json.dumps(settings.as_json())) == {
        "gaze_x": 0.3,
        "gaze_y": 0.6,
        "fov_a": 30,
        "fov_b": 10,
        "spp": 2,
        "acuity_model": "geisler-perry",
        "integrator": "cached",
        "width": 64,
        "height": 48,
        "views": 2,
        "reference_spp": 8,
        "repeats": 5,
        "seed": 7,
    }
