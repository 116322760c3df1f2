"""Stimuli that are rendered beforehand: of all conditions, views and kinds, and only once."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from compose.base.errors import UserError
from compose.eye.gaze import Gaze, GazeTrace
from hybrid.base.progress import no_progress
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.study.clips import PRESETS, Presentation, Stimuli, load_conditions
from hybrid.study.design import ANCHOR
from pathtrace.scene.scene import load_scene
from tests import small
from tests.hybrid.forests import rough_forest, white_dot

SIZE = 32, 24
STILL = Presentation("still", 1.0, 4, SIZE, FrameSettings(spp=1, fill=False), spp=4)
CONDITIONS = {
    "reference": {"method": "reference"},
    "hybrid": {"fov_a": 30.0, "fovea": "raw"},
    "splats": {"fov_a": 0.0, "acuity_model": "none"},
    "paths": {"method": "full", "spp": 1, "denoised": False},
}


@pytest.fixture(scope="module")
def renderer(backend) -> Renderer:
    scene = load_scene(small.corner())
    return Renderer(scene, rough_forest(scene))


def shown(folder, clip):
    return [np.asarray(Image.open(file)) for file in sorted((folder / "clips" / clip.name).glob("*.png"))]


def test_every_condition_of_every_view_has_its_clip(renderer, tmp_path):
    found = Stimuli(tmp_path, renderer, CONDITIONS, replace(STILL, views=2)).render(no_progress)
    assert len(found) == 2
    for clips in found.values():
        assert [clip.condition for clip in clips] == [*CONDITIONS, ANCHOR]
        images = [shown(tmp_path, clip) for clip in clips]
        assert {image.shape for each in images for image in each} == {(24, 32, 3)}
        # No two conditions are the same picture.
        assert len({each[0].tobytes() for each in images}) == len(clips)
    first, second = found.values()
    assert not np.array_equal(shown(tmp_path, first[0])[0], shown(tmp_path, second[0])[0])


def test_the_anchor_is_the_reference_without_its_details(renderer, tmp_path):
    clips = next(iter(Stimuli(tmp_path, renderer, CONDITIONS, STILL).render(no_progress).values()))
    truth, coarse = (shown(tmp_path, clips[n])[0].astype(float) for n in (0, -1))
    across, own = (np.abs(np.diff(image, axis=1)).mean() for image in (coarse, truth))
    assert across < 0.5 * own
    assert np.allclose(coarse.mean((0, 1)), truth.mean((0, 1)), atol=2)


def test_splats_alone_are_those_of_the_renderer(renderer, tmp_path):
    clips = next(iter(Stimuli(tmp_path, renderer, CONDITIONS, STILL).render(no_progress).values()))
    from compose.image.colour import bytes_from_radiance
    from pathtrace.region.neighbourhood import unseen_views

    camera = unseen_views(renderer.scene, 2, *SIZE)[0].camera
    alone = FrameSettings(fov_a=0, fov_b=0, acuity_model="none", camera=camera, fill=False)
    expected = bytes_from_radiance(renderer.frame(alone).composite)
    assert np.array_equal(shown(tmp_path, clips[2])[0], expected)


def test_conditions_of_like_names_have_clips_of_their_own(renderer, tmp_path):
    wanted = {"reference": CONDITIONS["reference"], "a b": {"fov_a": 0.0}, "a-b": {"fov_a": 30.0}, "ä b": {}}
    clips = next(iter(Stimuli(tmp_path, renderer, wanted, STILL).render(no_progress).values()))
    assert len({clip.name for clip in clips}) == len(wanted) + 1


def test_what_is_rendered_stays(renderer, tmp_path):
    Stimuli(tmp_path, renderer, CONDITIONS, STILL).render(no_progress)
    files = sorted((tmp_path / "clips").rglob("*.png"))
    before = [file.stat().st_mtime_ns for file in files]
    steps = []
    Stimuli(tmp_path, renderer, CONDITIONS, STILL).render(lambda done, total, step="": steps.append(done))
    assert [file.stat().st_mtime_ns for file in files] == before
    assert steps[-1] == len(CONDITIONS)


def test_an_interrupted_study_goes_on(renderer, tmp_path):
    def stop(done, total, step=""):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Stimuli(tmp_path, renderer, CONDITIONS, STILL).render(stop)
    done = {folder.name for folder in (tmp_path / "clips").iterdir() if folder.is_dir()}
    assert 0 < len(done) < len(CONDITIONS)
    found = Stimuli(tmp_path, renderer, CONDITIONS, STILL).render(no_progress)
    assert all((tmp_path / "clips" / clip.name).is_dir() for clips in found.values() for clip in clips)


def test_other_clips_are_not_mixed_in(renderer, tmp_path):
    Stimuli(tmp_path, renderer, CONDITIONS, STILL).render(no_progress)
    with pytest.raises(UserError, match="conditions"):
        Stimuli(tmp_path, renderer, CONDITIONS | {"more": {"fov_a": 5.0}}, STILL).render(no_progress)
    # More views are other ones.
    with pytest.raises(UserError, match="shown"):
        Stimuli(tmp_path, renderer, CONDITIONS, replace(STILL, views=3)).render(no_progress)


def test_a_moving_scene_plays(backend, tmp_path):
    scene = load_scene("room-moving")
    renderer = Renderer(scene, white_dot((0.0, 0.0, 0.0)))
    wanted = {"reference": CONDITIONS["reference"], "splats": {"fov_a": 0.0}}
    video = replace(STILL, kind="play", seconds=4.0, fps=1)
    truth, *_ = next(iter(Stimuli(tmp_path, renderer, wanted, video).render(no_progress).values()))
    images = shown(tmp_path, truth)
    assert len(images) == 4
    # The view stays, and something in it moves.
    changed = np.abs(images[0].astype(int) - images[2]).max(2) > 30
    assert 0 < changed.mean() < 0.5


def test_a_still_scene_does_not_play(renderer, tmp_path):
    with pytest.raises(UserError, match="does not move"):
        Stimuli(tmp_path, renderer, CONDITIONS, replace(STILL, kind="play")).render(no_progress)


@pytest.mark.parametrize("kind", ["trace", "walk"])
def test_videos_move_as_their_kind_says(renderer, tmp_path, kind):
    trace = GazeTrace((0.0, 0.6), (Gaze(0.2, 0.5), Gaze(0.8, 0.5))) if kind == "trace" else None
    video = replace(STILL, kind=kind, trace=trace)
    wanted = {"reference": CONDITIONS["reference"], "hybrid": CONDITIONS["hybrid"]}
    truth, hybrid, _ = next(iter(Stimuli(tmp_path, renderer, wanted, video).render(no_progress).values()))
    assert (hybrid.frames, hybrid.fps) == (4, 4.0)
    images = shown(tmp_path, truth)
    assert len(images) == 4
    moved = np.abs(images[0].astype(int) - images[-1]).mean()
    if kind == "walk":
        assert moved > 5
    if kind == "trace":
        assert hybrid.marker == ((0.2, 0.5), (0.2, 0.5), (0.2, 0.5), (0.8, 0.5))
    else:
        assert hybrid.marker == ((0.5, 0.5),)


def test_presets_are_conditions_that_can_be_rendered(tmp_path):
    import json

    file = tmp_path / "conditions.json"
    for preset in PRESETS.values():
        file.write_text(json.dumps(preset.conditions))
        assert load_conditions(file) == preset.conditions


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", "two conditions"),
        ('{"reference": {"method": "reference"}}', "two conditions"),
        ('{"reference": {"method": "reference"}, "b": 3}', "b: must be an object"),
        ('{"a": {"method": "hybrid"}, "b": {}}', "reference"),
        ('{"reference": {"method": "reference"}, "b": {"method": "magic"}}', "magic"),
        ('{"reference": {"method": "reference"}, "b": {"fov_c": 3}}', "fov_c"),
        ('{"reference": {"method": "reference"}, "b": {"camera": null}}', "camera"),
        ('{"reference": {"method": "reference"}, "b": {"fov_a": -3}}', "fov-a"),
        ('{"reference": {"method": "reference"}, "b": {"spp": "many"}}', "spp"),
        ('{"reference": {"method": "reference"}, "b": {"layers": 3}}', "layers"),
        ('{"reference": {"method": "reference"}, "anchor": {}}', "anchor"),
        ("{", "conditions.json"),
    ],
)
def test_conditions_that_cannot_be_rendered_are_one_line(tmp_path, text, said):
    file = tmp_path / "conditions.json"
    file.write_text(text)
    with pytest.raises(UserError, match=said) as raised:
        load_conditions(file)
    assert "\n" not in str(raised.value)
    assert str(file) in str(raised.value)
