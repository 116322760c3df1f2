"""The views that a forest was trained on, as its file holds them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from compose.base.errors import UserError
from hybrid.render.forest_attachments import attach_seconds, attach_views, seconds_of, views_of
from splat.io.forest_file import load_forest, save_forest
from tests.hybrid.forests import white_dot


def test_views_come_back_from_a_file_beside_what_else_is_attached(tmp_path, scene):
    dot = replace(white_dot((0, 0, 1)), attached={"other": torch.ones(2)})
    cameras = [scene.camera, scene.camera.resized(7, 5)]
    save_forest(tmp_path / "f", attach_views(dot, cameras))
    back = load_forest(tmp_path / "f")
    assert views_of(back) == cameras
    assert back.attached.keys() >= {"other"}


def test_other_forests_say_nothing_of_their_views():
    assert views_of(white_dot((0, 0, 1))) == []


@pytest.mark.parametrize(
    "table",
    [torch.zeros(2, 22), torch.zeros(2, 3).double(), torch.zeros(2, 22).double(), torch.tensor(1.0).double()],
)
def test_damaged_views_are_refused_in_one_line(table):
    forest = replace(white_dot((0, 0, 1)), attached={"views.cameras": table})
    with pytest.raises(UserError, match="training views are damaged") as refused:
        views_of(forest)
    assert "\n" not in str(refused.value)


def test_a_view_that_is_not_finite_is_refused(scene):
    forest = attach_views(white_dot((0, 0, 1)), [scene.camera])
    forest.attached["views.cameras"][0, 0] = float("inf")
    with pytest.raises(UserError, match="train the forest again"):
        views_of(forest)


def test_how_long_a_preparation_took_does_not_make_another_forest(tmp_path):
    dot = white_dot((0, 0, 1))
    assert seconds_of(dot) is None
    timed = attach_seconds(dot, 81.25)
    save_forest(tmp_path / "f", timed)
    back = load_forest(tmp_path / "f")
    assert seconds_of(back) == 81.25
    assert back.digest() == timed.digest() == dot.digest()
