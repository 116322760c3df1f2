"""Settings of an evaluation: what is refused, and what its file has of them."""

from __future__ import annotations

import json

import pytest

from compose.base.errors import UserError
from compose.eye.display import Display
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.render.frame_settings import FrameSettings
from pathtrace.dataset.frame_set import CaptureSettings
from splat.training.trainer import TrainingSettings


@pytest.mark.parametrize("name", ["width", "height", "views", "seeds", "reference_spp", "repeats"])
@pytest.mark.parametrize("value", [0, -2])
def test_counts_must_be_positive(name, value):
    with pytest.raises(UserError, match=f"{name.replace('_', '-')} {value}: must be positive"):
        EvaluationSettings(**{name: value})


def test_there_may_be_no_views_apart():
    assert EvaluationSettings(apart=0).apart == 0
    with pytest.raises(UserError, match=r"^apart -1: must not be negative$"):
        EvaluationSettings(apart=-1)


def test_a_gaze_outside_of_the_frame_and_a_missing_disc_are_refused():
    with pytest.raises(UserError, match=r"gaze 1.5 0.5: lies outside the frame"):
        EvaluationSettings(FrameSettings(gaze=(1.5, 0.5)))
    with pytest.raises(UserError, match=r"fov-a 0.0: there is no fovea to evaluate"):
        EvaluationSettings(FrameSettings(fov_a=0, fov_b=0))


def test_evaluation_json_has_all_settings_but_the_display():
    settings = EvaluationSettings(FrameSettings((0.3, 0.6), 30, 10, 2), 64, 48, 2, 1, 4, 8, False, 5, True, 7)
    assert json.loads(json.dumps(settings.as_json())) == {
        "gaze_x": 0.3,
        "gaze_y": 0.6,
        "fov_a": 30,
        "fov_b": 10,
        "spp": 2,
        "acuity_model": "fovvideovdp",
        "integrator": "cached",
        "width": 64,
        "height": 48,
        "views": 2,
        "apart": 1,
        "seeds": 4,
        "reference_spp": 8,
        "denoised_references": False,
        "repeats": 5,
        "quick": True,
        "seed": 7,
    }


@pytest.mark.parametrize("seed", [-1, 1 << 64, 0.5])
def test_settings_check_seeds_before_any_work(seed):
    for settings in (EvaluationSettings, CaptureSettings, TrainingSettings):
        with pytest.raises(UserError, match=rf"^seed {seed}: must be a whole number from 0 to "):
            settings(seed=seed)


@pytest.mark.parametrize(
    ("frame", "size", "said"),
    [
        (
            FrameSettings((0, 0), 1.9, 1.4),
            (512, 512),
            r"^fov-a 1.9, fov-b 1.4, gaze 0 0, size 512 512: the \w+ region",
        ),
        (FrameSettings(fov_a=0.05, fov_b=0), (512, 512), "^the foveal region of this frame is empty"),
        (
            FrameSettings(fov_a=0.3, fov_b=0),
            (512, 512),
            "^fov-a 0.3: the fovea is 2 x 2 pixels; must be at least 4 x 4",
        ),
        (FrameSettings(), (1024, 12), "^size 1024 12: must be at least 22 each"),
        (
            FrameSettings(display=Display(10**9, 10**9, 1.0)),
            (64, 64),
            r"^display fov 1.0: 9.99975e.08 pixels per degree",
        ),
    ],
)
def test_what_no_metric_can_measure_is_refused(frame, size, said):
    with pytest.raises(UserError, match=said):
        EvaluationSettings(frame, *size).require_measurable()


@pytest.mark.parametrize(
    "frame", [FrameSettings(), FrameSettings(fov_a=30, fov_b=30), FrameSettings(fov_a=500)]
)
@pytest.mark.parametrize("size", [(40, 40), (64, 48), (512, 512), (512, 22)])
def test_what_metrics_can_measure_is_accepted(frame, size):
    EvaluationSettings(frame, *size).require_measurable()
