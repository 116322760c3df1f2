"""The fusion that training leaves in a forest, and the examples that it is fitted to."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from compose.fusion import fitting
from compose.fusion.fitting import Example, Proof
from compose.fusion.network import Fusion
from hybrid.preparation import fusion_training as module
from hybrid.preparation.fusion_training import fusion_steps, fusion_verdicts, with_fusion
from hybrid.render.forest_attachments import attach_fusion, fusion_of
from pathtrace.dataset.capture import capture
from pathtrace.dataset.captured_frames import read_estimate, read_frame, read_radiance
from pathtrace.dataset.frame_set import CaptureSettings, FrameSet
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest, save_forest
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import rough_forest
from tests.hybrid.preparation.conftest import ignore

# Found where fitting is replaced.
PROOF = Proof(Fusion().shares.numpy(), np.zeros((2, 5, 4), np.float32))


@pytest.fixture(scope="module")
def forest(backend) -> Forest:
    return rough_forest(load_scene(small.corner()))


@pytest.fixture(scope="module")
def large(backend, tmp_path_factory) -> FrameSet:
    """Frames that are large enough to fit a fusion to."""
    settings = CaptureSettings(views=2, held_out=2, width=64, height=64, spp=1, held_out_spp=14)
    return capture(load_scene(small.corner()), tmp_path_factory.mktemp("large"), settings, ignore)


@pytest.fixture(scope="module")
def examples(large, forest):
    """Returns what the fusion is fitted to with a seed."""

    @cache
    def found(seed: int) -> list[Example]:
        kept = []

        def noting(examples, seed, progress) -> Fusion:
            kept.extend(examples)
            return Fusion().requires_grad_(False)

        with pytest.MonkeyPatch.context() as monkeypatch:
            monkeypatch.setattr(module, "fit", noting)
            monkeypatch.setattr(module, "prove", lambda examples, seed, progress: PROOF)
            with_fusion(large, forest, seed, ignore)
        return kept

    return found


def test_training_leaves_a_fusion_in_the_forest(large, forest, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ITERATIONS", 3)
    monkeypatch.setattr(fitting.fit, "__defaults__", (3,))
    for place in (module, fitting):
        monkeypatch.setattr(place, "TRIAL_ITERATIONS", 2)
    steps = []
    found = with_fusion(large, forest, 0, lambda done, total: steps.append((done, total)))
    assert fusion_steps(large) == 7
    assert steps == [(number, 7) for number in range(1, 8)]
    assert fusion_of(forest) is None
    save_forest(tmp_path / "f.safetensors", found)
    again = fusion_of(load_forest(tmp_path / "f.safetensors"))
    for name, tensor in fusion_of(found).state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name])


def test_every_estimate_of_every_unseen_view_is_an_example_of_either_denoiser(large, examples):
    views = [entry for entry in large.held_out + large.close_ups if entry.camera.width >= 64]
    assert len(views) > 1
    found = examples(0)
    # Two more of each view with several estimates have two of these side by side.
    mixed = [4 * (len(entry.estimates) > 1) for entry in views]
    assert len(found) == sum(mixed) + 2 * sum(len(entry.estimates) for entry in views)
    assert [example.parents.quick for example in found] == [False, True] * (len(found) // 2)
    position = 0
    for number, (entry, further) in enumerate(zip(views, mixed, strict=True)):
        for spp, file in entry.estimates.items():
            example, estimate = found[position], read_estimate(file)
            assert example.view == found[position + 1].view == number
            np.testing.assert_array_equal(example.reference.denoised, read_frame(entry.file).radiance)
            for half, name in zip(example.reference.halves, entry.halves, strict=True):
                np.testing.assert_array_equal(half, read_radiance(name))
            np.testing.assert_array_equal(example.parents.traced, estimate.radiance)
            np.testing.assert_array_equal(found[position + 1].parents.traced, estimate.radiance)
            assert not np.array_equal(example.parents.denoised, found[position + 1].parents.denoised)
            np.testing.assert_array_equal(example.parents.albedo, estimate.albedo)
            np.testing.assert_array_equal(example.parents.normal, estimate.normal)
            assert (example.parents.count == spp).all()
            assert np.isinf(example.parents.variance).all()
            position += 2
        position += further


def test_examples_show_the_finest_layer(arrays, large, forest, examples):
    entry, example = large.held_out[0], examples(0)[0]
    shown = ForestRenderer(arrays, forest).render_layer(entry.camera, 3).numpy()
    np.testing.assert_array_equal(example.parents.splat, shown)
    # Trained on 32 x 32 pixels of 60 degrees.
    assert example.parents.enlargement == pytest.approx(entry.camera.fy / (16 / np.tan(np.radians(30))))


def test_mixed_examples_have_one_of_two_estimates_in_each_pixel(large, examples):
    entry = large.held_out[0]
    estimates = {spp: read_estimate(file) for spp, file in entry.estimates.items()}
    counts = []
    for example in examples(0)[2 * len(estimates) : 2 * len(estimates) + 4]:
        parents = example.parents
        present = {int(count) for count in np.unique(parents.count)}
        counts.append(present)
        assert len(present) == 2
        for spp in present:
            inside = parents.count[..., 0] == spp
            # At least a fifth of the pixels each, in patches rather than one by one.
            assert 0.15 < inside.mean() < 0.85
            for name in ("radiance", "albedo", "normal"):
                found = parents.traced if name == "radiance" else getattr(parents, name)
                np.testing.assert_array_equal(found[inside], getattr(estimates[spp], name)[inside])
            borders = (inside[:, 1:] != inside[:, :-1]).mean()
            assert borders < 0.2
    assert counts


def test_a_seed_decides_the_mixture(examples):
    first, other = examples(0), examples(1)
    again = examples.__wrapped__(0)
    equal = lambda a, b: np.array_equal(a.parents.count, b.parents.count)  # noqa: E731
    assert all(map(equal, first, again))
    assert not all(map(equal, first, other))


def test_frames_without_examples_leave_the_forest_as_it_is(frames, large, forest):
    bare = replace(
        large,
        entries=[replace(entry, estimates={}, halves=()) for entry in large.entries],
        close_ups=[replace(entry, estimates={}, halves=()) for entry in large.close_ups],
    )
    for without in (frames, bare):
        assert fusion_steps(without) == 0
        assert with_fusion(without, forest, 0, ignore) is forest
    assert fusion_steps(large) == fitting.ITERATIONS + 2 * fitting.TRIAL_ITERATIONS == 1100


def test_close_ups_belong_to_the_view_that_they_are_parts_of(large):
    bigger = [replace(entry, camera=entry.camera.resized(128, 128)) for entry in large.close_ups]
    found = module._usable(replace(large, close_ups=bigger))
    assert [number for number, _ in found] == [0, 1, 0, 0, 1, 1]


def test_large_views_are_learnt_from_in_parts(large, examples):
    (example, *_) = examples(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_MOST", 40)
        part = module._part(example, np.random.default_rng(0))
    assert part.parents.count.shape == (40, 40, 1)
    whole, cut = example.parents.traced, part.parents.traced
    places = [
        (y, x) for y in range(25) for x in range(25) if np.array_equal(whole[y : y + 40, x : x + 40], cut)
    ]
    ((y, x),) = places
    for image, of_part in zip(example.reference.halves, part.reference.halves, strict=True):
        np.testing.assert_array_equal(image[y : y + 40, x : x + 40], of_part)


def test_verdicts_say_what_is_shown(forest):
    assert fusion_verdicts(forest) == []
    fusion = Fusion()
    fusion.shares[1, 2, 1] = torch.tensor([0.25, 0.25, 0.5])
    fusion.gains[1, 2, 1] = 1.5
    rows = fusion_verdicts(attach_fusion(forest, fusion))
    assert len(rows) == 40
    (row,) = (row for row in rows if row["quick"] and row["spp"] == 4 and row["enlargement"] == 1)
    assert (row["network"], row["denoised"], row["splat"], row["gain_db"]) == (0.25, 0.25, 0.5, 1.5)
