"""The fusion that training leaves in a forest, and the examples that it is fitted to."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from compose.fusion import fitting
from compose.fusion.fitting import Example
from compose.fusion.network import Fusion
from hybrid.frame.fusion import fusion_of
from hybrid.training import fusion as module
from hybrid.training.fusion import fusion_steps, with_fusion
from pathtrace.dataset.capture import capture
from pathtrace.dataset.exr import read_estimate, read_frame
from pathtrace.dataset.frames import FrameSet
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest, save_forest
from splat.lod.renderer import ForestRenderer
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import rough_forest
from tests.hybrid.training.conftest import ignore


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
            return Fusion()

        with pytest.MonkeyPatch.context() as monkeypatch:
            monkeypatch.setattr(module, "fit", noting)
            with_fusion(large, forest, seed, ignore)
        return kept

    return found


def test_training_leaves_a_fusion_in_the_forest(large, forest, tmp_path, monkeypatch):
    monkeypatch.setattr(fitting, "ITERATIONS", 3)
    steps = []
    found = with_fusion(large, forest, 0, lambda done, total: steps.append((done, total)))
    assert steps == [(number, 3) for number in range(1, 4)]
    assert fusion_of(forest) is None
    save_forest(tmp_path / "f.safetensors", found)
    again = fusion_of(load_forest(tmp_path / "f.safetensors"))
    for name, tensor in fusion_of(found).state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name])


def test_every_estimate_of_every_unseen_view_is_an_example(large, examples):
    views = [entry for entry in large.held_out + large.close_ups if entry.camera.width >= 64]
    assert len(views) > 1
    found = examples(0)
    # Two more of each view with several estimates have two of these side by side.
    mixed = [2 * (len(entry.estimates) > 1) for entry in views]
    assert len(found) == sum(mixed) + sum(len(entry.estimates) for entry in views)
    position = 0
    for entry, further in zip(views, mixed, strict=True):
        reference = read_frame(entry.file).radiance
        for spp, file in entry.estimates.items():
            example, estimate = found[position], read_estimate(file)
            np.testing.assert_array_equal(example.reference, reference)
            np.testing.assert_array_equal(example.parents.traced, estimate.radiance)
            np.testing.assert_array_equal(example.parents.albedo, estimate.albedo)
            np.testing.assert_array_equal(example.parents.normal, estimate.normal)
            assert (example.parents.count == spp).all()
            assert np.isinf(example.parents.variance).all()
            position += 1
        position += further


def test_examples_show_the_finest_layer(arrays, large, forest, examples):
    entry, example = large.held_out[0], examples(0)[0]
    shown = ForestRenderer(arrays, forest).render_layer(entry.camera, 3).image()
    np.testing.assert_array_equal(example.parents.splat, shown)
    # Trained on 32 x 32 pixels of 60 degrees.
    assert example.parents.enlargement == pytest.approx(entry.camera.fy / (16 / np.tan(np.radians(30))))


def test_mixed_examples_have_one_of_two_estimates_in_each_pixel(large, examples):
    entry = large.held_out[0]
    estimates = {spp: read_estimate(file) for spp, file in entry.estimates.items()}
    counts = []
    for example in examples(0)[len(estimates) : len(estimates) + 2]:
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
        entries=[replace(entry, estimates={}) for entry in large.entries],
        close_ups=[replace(entry, estimates={}) for entry in large.close_ups],
    )
    for without in (frames, bare):
        assert fusion_steps(without) == 0
        assert with_fusion(without, forest, 0, ignore) is forest
    assert fusion_steps(large) == fitting.ITERATIONS == 1200
