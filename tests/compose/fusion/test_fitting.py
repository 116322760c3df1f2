"""Fitting: that it pays, that it repeats, and what it trains on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.fusion import fitting
from compose.fusion.fitting import LEAST_SIZE, STACK, Example, FusionReference, fit
from compose.fusion.network import Fusion
from compose.fusion.parents import Parents
from tests import small
from tests.compose.fusion.examples import blurred, cropped, error, example, fuse, radiance_of


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """On a busy machine, threads that wait for each other take ten times as long as one alone."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def fit_quickly(examples: Sequence[Example], iterations: int, seed: int = 0) -> Fusion:
    return fit(examples, seed, lambda done, total: None, iterations)


@pytest.fixture(scope="module")
def fitted(one_thread) -> Fusion:
    return fit_quickly([example(seed, spp) for seed in range(3) for spp in (2, 16)], 250)


@pytest.mark.parametrize("spp", [2, 16])
def test_fused_is_better_than_the_better_parent(fitted, spp):
    given = example(11, spp)
    fused = fuse(given.parents, fitted)
    best = min(error(getattr(given.parents, name), radiance_of(given)) for name in ("splat", "denoised"))
    assert error(fused.radiance, radiance_of(given)) < best - 6


def test_splats_of_another_world_are_noticed(fitted):
    """Something moved: no worse than the denoised samples by more than 0.2 dB."""
    given = example(12, 16)
    moved = replace(given.parents, splat=np.roll(given.parents.splat, 20, axis=0))
    fused = fuse(moved, fitted)
    assert error(fused.radiance, radiance_of(given)) < error(given.parents.denoised, radiance_of(given)) + 0.2


def test_a_share_of_the_splats_does_not_bring_another_world_back(fitted):
    """No worse than the network alone by more than 0.5 dB; the plain mixture would be, by far."""
    given = example(12, 16)
    unknown = np.full_like(given.parents.variance, np.inf)
    moved = replace(given.parents, splat=np.roll(given.parents.splat, 20, axis=0), variance=unknown)
    sharing = deepcopy(fitted)
    sharing.shares[:] = torch.tensor([0.5, 0.0, 0.5])
    alone, shared = (fuse(moved, fusion).radiance for fusion in (fitted, sharing))
    right = radiance_of(given)
    assert error(shared, right) < error(alone, right) + 0.5
    assert error(0.5 * (alone + moved.splat), right) > error(alone, right) + 5


def flawed(seed: int) -> Example:
    """Denoised samples with blotches, and splats with as much noise that has no large waves."""
    given, rng = example(seed, 2), small.rng(100 + seed)
    truth, size = radiance_of(given), 96
    blotches = blurred(rng.normal(size=(size, size, 3)).astype(np.float32), 3)
    noise = rng.normal(size=(size, size, 3)).astype(np.float32)
    noise -= blurred(noise, 1)
    parts = {"denoised": blotches, "splat": noise}
    flaws = {name: truth * np.exp(0.1 * image / image.std()) for name, image in parts.items()}
    return replace(given, parents=replace(given.parents, **flaws))


def test_blotches_count_more_than_as_much_noise_in_single_pixels():
    fusion = fit_quickly([flawed(seed) for seed in range(3)], 60)
    weights = fuse(flawed(7).parents, fusion).weights.mean(axis=(0, 1))
    assert weights[2] > 1.3 * weights[1]


def test_a_fitted_network_does_not_train_further(fitted):
    assert not fitted.training
    assert not any(parameter.requires_grad for parameter in fitted.parameters())


def test_the_seed_decides_the_network():
    one, again, other = (fit_quickly([example(0, 4)], 3, seed).state_dict() for seed in (5, 5, 6))
    assert all(torch.equal(one[name], again[name]) for name in one)
    assert not all(torch.equal(one[name], other[name]) for name in one)


def test_fitting_leaves_the_random_numbers_of_others_alone():
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    fit_quickly([example(0, 4)], 1)
    assert torch.equal(torch.rand(4), expected)


def test_progress_is_reported_after_each_step():
    calls = []
    fit([example(0, 4)], 0, lambda done, total: calls.append((done, total)), 3)
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_without_examples_there_is_nothing_to_fit_to():
    with pytest.raises(ValueError, match="no examples"):
        fit([], 0, lambda done, total: None)


def part(given: Example, height: int, width: int) -> Example:
    right = radiance_of(given)[:height, :width]
    return Example(cropped(given.parents, height, width), FusionReference(right, (right, right)), 0)


@pytest.mark.parametrize(("height", "width"), [(LEAST_SIZE - 1, 80), (80, LEAST_SIZE - 1)])
def test_examples_smaller_than_a_patch_are_refused(height, width):
    given = example(0, 4)
    with pytest.raises(ValueError, match="at least 64 x 64"):
        fit([part(given, height, width)], 0, lambda done, total: None)


def test_an_example_of_one_patch_is_large_enough():
    fit_quickly([part(example(0, 4), LEAST_SIZE, LEAST_SIZE)], 1)


def coordinates(count: float, size: int = 80) -> Example:
    """All images hold the column, the row and 1, so that a patch shows where it comes from."""
    row, column = np.mgrid[0:size, 0:size].astype(np.float32)
    image = np.stack([column, row, np.ones_like(row)], axis=2)
    parents = Parents(*[image] * 6, np.full((size, size, 1), count, np.float32), 1.0)
    return Example(parents, FusionReference(image, (image, image)), 0)


def patches(count: float, number: int) -> list[dict[str, torch.Tensor]]:
    rng = np.random.default_rng(0)
    stack = coordinates(count).stack()
    return [STACK.parts(fitting._patch(stack, rng)) for _ in range(number)]


def test_all_images_of_a_patch_come_from_the_same_place():
    firsts, turned, mirrored = set(), 0, 0
    for patch in patches(4, 200):
        assert patch["count"].shape == (1, 64, 64)
        for name in ("denoised", "albedo", "normal"):
            assert torch.equal(patch[name], patch["traced"])
        column, row, _ = patch["traced"]
        is_turned = bool(row[0, 0] != row[0, 1])
        turned += is_turned
        along = column[:, 0] if is_turned else column[0]
        mirrored += bool(along[0] > along[1])
        assert (along.sort().values.diff() == 1).all()
        firsts.add((float(column.min()), float(row.min())))
    # All 17 x 17 positions are as likely, and so are turned and mirrored patches.
    assert {x for x, _ in firsts} == {y for _, y in firsts} == set(range(17))
    assert 70 < turned < 130
    assert 70 < mirrored < 130


@pytest.mark.parametrize(("count", "share"), [(4, 0.25), (3, 0.05)])
def test_some_patches_have_splats_of_another_world(count, share):
    """A quarter of them; few where too few samples could tell."""
    found = patches(count, 600)
    changed = sum(not torch.equal(patch["splat"], patch["traced"]) for patch in found) / len(found)
    assert changed == pytest.approx(share, abs=0.05)


def test_another_world_has_changed_as_a_whole_or_in_part():
    rng = np.random.default_rng(0)
    splat = torch.rand((3, 64, 64), generator=torch.Generator().manual_seed(0))
    shares = []
    for _ in range(200):
        before = splat.clone()
        other = fitting._changed(splat, rng)
        assert torch.equal(splat, before)
        assert other.shape == splat.shape
        assert other.isfinite().all()
        assert other.min() >= 0
        rows, columns = torch.nonzero((other != splat).any(0), as_tuple=True)
        # What has changed is a box of at least 8 x 8 pixels, of which nearly all differ.
        sides = int(rows.max() - rows.min()) + 1, int(columns.max() - columns.min()) + 1
        assert min(sides) >= 7
        assert len(rows) > 0.9 * sides[0] * sides[1]
        shares.append(len(rows) / 64**2)
    assert 0.35 < np.mean(np.array(shares) > 0.99) < 0.65


def test_every_kind_of_change_occurs():
    """Brighter or darker, another colour, moved, turned, or covered by one colour."""
    rng = np.random.default_rng(0)
    splat = torch.rand((3, 64, 64), generator=torch.Generator().manual_seed(0)) + 0.1
    kinds = set()
    for _ in range(300):
        other = fitting._changed(splat, rng)
        if not (other != splat).any(0).all():
            continue
        ratio = other / splat
        if torch.allclose(ratio, ratio[0, 0, 0]):
            kinds.add("brightness")
        elif torch.allclose(ratio, ratio[:, :1, :1]):
            kinds.add("colour")
        elif torch.allclose(other, other[:, :1, :1]):
            kinds.add("covered")
        elif torch.equal(other, splat.flip(1, 2)):
            kinds.add("turned")
        elif torch.equal(other.flatten(1).sort(1).values, splat.flatten(1).sort(1).values):
            kinds.add("moved")
    assert kinds == {"brightness", "colour", "covered", "turned", "moved"}
