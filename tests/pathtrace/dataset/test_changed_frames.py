"""Frames that outlast a change of their scene: what still holds of them stays, the rest is traced anew."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from compose.image.colour import srgb_from_radiance
from pathtrace.dataset.captured_frames import geometry_of, read_frame
from pathtrace.dataset.changed_frames import SeenAgain, seen_again
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.dataset.growing import GrowingFrames, StoredFrames, Wanted
from pathtrace.scene.scene import load_scene
from pathtrace.trace import Integrator
from pathtrace.trace.traced_images import trace_frame
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.extremes import extreme
from tests.moving import moving_corner

WIDTH, HEIGHT, SPP = 160, 96, 16


def silent(done: int, total: int) -> None:
    """Ignores progress."""


def changed_corner(**parts: dict[str, Any]) -> dict[str, Any]:
    """The corner with other parts."""
    return {
        name: part | parts.get(name, {}) if name in parts else part for name, part in small.corner().items()
    }


def moved_board() -> dict[str, Any]:
    """The corner with its board higher and further to the right."""
    place = mi.ScalarTransform4f().translate([-0.4, 0.35, 1.2]).scale(0.5)
    return changed_corner(board={"to_world": place})


def tracer_of(scene: dict[str, Any]) -> Tracer:
    return Tracer(load_scene(scene))


def grown(folder: Path, tracer: Tracer, views: int = 2) -> GrowingFrames:
    frames = GrowingFrames(folder, tracer, Integrator.PATH.value, 3)
    camera = tracer.scene.camera.resized(WIDTH, HEIGHT)
    frames.grow([Wanted(camera.moved_right(0.1 * number), SPP) for number in range(views)], silent)
    return frames


@pytest.fixture(scope="module")
def before(backend, tmp_path_factory) -> Path:
    """Frames of the corner."""
    folder = tmp_path_factory.mktemp("before")
    grown(folder, tracer_of(small.corner()))
    return folder


def taken_over(before: Path, folder: Path, scene: dict[str, Any]) -> tuple[GrowingFrames, bool]:
    frames = GrowingFrames(folder, tracer_of(scene), Integrator.PATH.value, 3)
    return frames, frames.take_over(StoredFrames(before), 2, silent)


def looked(before: Path, scene: dict[str, Any]) -> SeenAgain:
    """The first frame of before, as it is now."""
    frames = StoredFrames(before)
    entry = read_frame_set(before).training[0]
    return seen_again(tracer_of(scene), frames.camera(0), read_frame(entry.file), 7)


def test_hardly_a_tile_of_an_unchanged_scene_counts_as_changed(before):
    assert looked(before, small.corner()).tiles.mean() < 0.1


def test_what_has_moved_is_found_where_it_was_and_where_it_is(before):
    seen = looked(before, moved_board())
    entry = read_frame_set(before).training[0]
    was = read_frame(entry.file).shape != geometry_of(tracer_of(moved_board()), seen.camera)[2]
    assert was.mean() > 0.02
    # All of it but single pixels of an edge.
    assert seen.pixels[was].mean() > 0.98
    assert seen.tiles.mean() < 0.6


@pytest.mark.parametrize(
    "parts",
    [
        {"board": {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.2, 0.2]}}}},
        {"ball": {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.1}}}},
    ],
    ids=["another colour", "no mirror any more"],
)
def test_another_material_is_found(before, parts):
    scene = changed_corner(**parts)
    seen, old = looked(before, scene), read_frame(read_frame_set(before).training[0].file)
    now = trace_frame(tracer_of(scene), seen.camera, SPP, 5)
    different = (np.abs(now.albedo - old.albedo) > 0.1).any(axis=2)
    assert different.mean() > 0.01
    assert seen.pixels[different].mean() > 0.97
    assert seen.tiles.mean() < 0.7


def test_what_has_not_changed_stays_and_the_rest_is_the_truth(before, tmp_path):
    frames, taken = taken_over(before, tmp_path, moved_board())
    assert taken
    assert frames.samples == StoredFrames(before).samples
    tracer = tracer_of(moved_board())
    for number, entry in enumerate(read_frame_set(tmp_path).training):
        old, new = StoredFrames(before).radiance(number), frames.radiance(number)
        same = (old == new).all(axis=2)
        assert 0.3 < same.mean() < 0.95
        truth = trace_frame(tracer, entry.camera, 256, 11).denoised()
        errors = [np.mean((srgb_from_radiance(of) - srgb_from_radiance(truth)) ** 2) for of in (old, new)]
        assert errors[1] < 0.05 * errors[0]
        # The noisy halves as well, and all that is known beside light.
        halves = [half.radiance.mean() for half in frames.halves(number)]
        assert np.mean(halves) == pytest.approx(truth.mean(), rel=0.03)
        np.testing.assert_array_equal(read_frame(entry.file).shape, geometry_of(tracer, entry.camera)[2])
    # They can grow further.
    camera = frames.camera(0)
    views = [
        Wanted(frames.camera(0), SPP),
        Wanted(frames.camera(1), SPP + 4),
        Wanted(camera.moved_right(-0.1), 4),
    ]
    frames.grow(views, silent)
    assert frames.samples == [SPP, SPP + 4, 4]


def test_new_samples_are_unbiased(before):
    """Of many, the mean in changed tiles is that of whole frames."""
    seen, tracer = looked(before, moved_board()), tracer_of(moved_board())
    half = StoredFrames(before).halves(0)[0]
    means = [seen.traced(tracer, half, 8, seed).radiance[seen.pixels].mean() for seed in range(24)]
    whole = [
        trace_frame(tracer, seen.camera, 8, 100 + seed).radiance[seen.pixels].mean() for seed in range(24)
    ]
    error = np.hypot(np.std(means), np.std(whole)) / np.sqrt(24)
    assert abs(np.mean(means) - np.mean(whole)) < 4 * error


def test_frames_of_the_same_scene_are_not_even_looked_at(before, tmp_path):
    frames, taken = taken_over(before, tmp_path, small.corner())
    assert taken
    for name in (file.name for file in (before / "frames").iterdir()):
        assert os.path.samefile(before / "frames" / name, tmp_path / "frames" / name)
    frames.grow([Wanted(frames.camera(0), 2 * SPP), Wanted(frames.camera(1), SPP)], silent)
    # Files of earlier passes go from here only.
    assert StoredFrames(before).radiance(0).shape == (HEIGHT, WIDTH, 3)


def test_only_as_many_frames_as_are_wanted_are_taken_over(before, tmp_path):
    """A pass that was interrupted may have left more than its stage knows of."""
    frames = GrowingFrames(tmp_path, tracer_of(small.corner()), Integrator.PATH.value, 3)
    assert not frames.take_over(StoredFrames(before), 3, silent)
    assert frames.take_over(StoredFrames(before), 1, silent)
    assert frames.samples == [SPP]
    assert len(list((tmp_path / "frames").iterdir())) == 3


def test_where_all_has_changed_frames_begin_anew(before, tmp_path):
    lamp = small.corner()["lamp"]["emitter"] | {"radiance": {"type": "rgb", "value": 1.0}}
    _, taken = taken_over(before, tmp_path, changed_corner(lamp={"emitter": lamp}))
    assert not taken
    assert not list((tmp_path / "frames").iterdir())


def test_what_moves_begins_anew(before, tmp_path):
    frames = GrowingFrames(tmp_path / "now", Tracer(moving_corner(tmp_path)), Integrator.PATH.value, 3)
    assert not frames.take_over(StoredFrames(before), 2, silent)


@extreme(
    "frames of before a change that are damaged, or whose taking over is interrupted",
    given="a frame cut in half; Ctrl-C after the first of two views",
    expected="one line that names the file; nothing is left that could be taken for frames",
)
def test_frames_that_cannot_be_taken_over_leave_nothing(tmp_path, backend, got):
    grown(tmp_path / "before", tracer_of(small.corner()))

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    frames = GrowingFrames(tmp_path / "now", tracer_of(moved_board()), Integrator.PATH.value, 3)
    with pytest.raises(KeyboardInterrupt):
        frames.take_over(StoredFrames(tmp_path / "before"), 2, interrupt)
    assert not list((tmp_path / "now" / "frames").iterdir())
    file = read_frame_set(tmp_path / "before").training[1].file
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(UserError, match=file.name) as refused:
        frames.take_over(StoredFrames(tmp_path / "before"), 2, silent)
    assert not list((tmp_path / "now" / "frames").iterdir())
    got(str(refused.value).replace(str(tmp_path), ""))


def test_frames_of_odd_sizes_begin_anew(tmp_path, backend):
    tracer = tracer_of(small.corner())
    frames = GrowingFrames(tmp_path / "before", tracer, Integrator.PATH.value, 3)
    frames.grow([Wanted(tracer.scene.camera.resized(48, 18), 2)], silent)
    again = GrowingFrames(tmp_path / "now", tracer_of(moved_board()), Integrator.PATH.value, 3)
    assert not again.take_over(StoredFrames(tmp_path / "before"), 1, silent)


def test_frames_in_other_coordinates_begin_anew(backend, tmp_path):
    """Those of a scene that has become much larger, for instance."""
    grown(tmp_path / "before", tracer_of(small.corner()), 1)
    description = tmp_path / "before" / "transforms.json"
    document = json.loads(description.read_text())
    document["scene"] |= {"origin": [0.0, 0.0, 0.0], "unit": 100.0}
    description.write_text(json.dumps(document))
    frames = GrowingFrames(tmp_path / "now", tracer_of(moved_board()), Integrator.PATH.value, 3)
    assert not frames.take_over(StoredFrames(tmp_path / "before"), 1, silent)
    document["scene"].pop("unit")
    document["scene"].pop("origin")
    description.write_text(json.dumps(document))
    assert frames.take_over(StoredFrames(tmp_path / "before"), 1, silent)


def test_only_the_first_frames_can_be_taken_over(before, tmp_path):
    frames = grown(tmp_path, tracer_of(small.corner()), 1)
    with pytest.raises(ValueError, match="already"):
        frames.take_over(StoredFrames(before), 2, silent)
