"""A bundled scene in the open: what its frames say of the sky, and which mirrors show it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hybrid.preparation import training_views as module
from hybrid.preparation.training_views import training_view
from pathtrace.dataset.captured_frames import render_frame
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer
from splat.training.training_view import place_of, placed


@pytest.fixture(scope="module")
def meadow(backend):
    scene = load_scene("meadow")
    camera = scene.camera.resized(64, 64)
    return camera, render_frame(Tracer(scene), camera, 4, 0)


def test_the_meadow_lies_under_a_sky(meadow, monkeypatch):
    camera, frame = meadow
    monkeypatch.setattr(module, "read_frame", lambda file, size: frame)
    view = training_view(SimpleNamespace(file=None, size=(64, 64), camera=camera, time=0.0))
    sky = np.isinf(view.distance)
    # The pond shows the sky, and lies below the horizon.
    assert 0.2 < np.isinf(frame.depth).mean() < sky.mean() < 0.6
    assert sky[40:].any()
    own = placed(view, place_of([view]))
    assert (own.distance[sky] == own.sky).all()
    assert own.distance[~sky].max() < 0.05 * own.sky


def test_a_mirror_that_shows_nothing_is_where_it_is(meadow, monkeypatch):
    camera, frame = meadow
    dark = replace(frame, radiance=np.where(np.isinf(frame.unfolded)[..., None], 0, frame.radiance))
    monkeypatch.setattr(module, "read_frame", lambda file, size: dark)
    view = training_view(SimpleNamespace(file=None, size=(64, 64), camera=camera, time=0.0))
    np.testing.assert_array_equal(np.isinf(view.distance), np.isinf(frame.depth))
