"""Training learns, repeats, and resumes after an interruption."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.forest import forest_of
from splat.model.gaussians import perceptual_from_radiance
from splat.model.points import remoteness
from splat.model.trees import check_forest
from splat.raster.differentiable import render_differentiable
from splat.training import density
from splat.training.trainer import Trainer, TrainingSettings, most_layers, training_schedule
from splat.training.training_view import pixel_footprint, reduced
from tests.splat.samples import equal
from tests.splat.training.frames import WALLS, closed_sphere, wall

SETTINGS = TrainingSettings(iterations=200, gaussians=900, layers=2, degree=1)


# With density control every 5 steps, both layers change: see `often`.
SHORT = TrainingSettings(iterations=60, gaussians=400, layers=2, degree=1)


@pytest.fixture(scope="module")
def trained(arrays) -> Trainer:
    trainer = Trainer(arrays, WALLS, SETTINGS)
    trainer.run()
    return trainer


@pytest.fixture
def often(monkeypatch) -> None:
    """Density control every 5 steps."""
    monkeypatch.setattr(density, "_EVERY", 5)
    monkeypatch.setattr(density, "_CHANGES", 1)


@pytest.fixture(scope="module")
def short(arrays) -> Trainer:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(density, "_EVERY", 5)
        patch.setattr(density, "_CHANGES", 1)
        trainer = Trainer(arrays, WALLS, SHORT)
        trainer.run()
    return trainer


def same(a: Trainer, b: Trainer) -> bool:
    """Whether two forests agree in every bit."""
    return all(
        torch.equal(x.parent, y.parent) and equal(x.gaussians, y.gaussians)
        for x, y in zip(a.forest(), b.forest(), strict=True)
    )


def test_it_learns_a_view_it_never_saw(arrays, trained):
    """The lamp's edge has no antialiasing in these frames and keeps an error; the rest must be learnt."""
    unseen = wall(0.2)

    def error(trainer: Trainer) -> float:
        image = perceptual_from_radiance(
            render_differentiable(arrays, trainer.forest()[-1].gaussians, trainer.place.camera(unseen.camera))
        )
        target = perceptual_from_radiance(torch.from_numpy(unseen.radiance))
        return float(((image.clamp(0, 1) - target.clamp(0, 1)) ** 2).mean())

    # Seen: 0.0047 of 0.034.
    assert error(trained) < 0.25 * error(Trainer(arrays, WALLS, SETTINGS))


def test_a_lamp_stays_a_lamp(arrays, trained):
    image = render_differentiable(
        arrays, trained.forest()[-1].gaussians, trained.place.camera(WALLS[1].camera)
    )
    lamp = torch.from_numpy(WALLS[1].radiance)[..., 0] > 1
    assert image[lamp].median() == pytest.approx(50, rel=0.15)


def test_density_control_reaches_the_requested_number(trained):
    coarse, fine = trained.forest()
    assert 0.9 * SETTINGS.gaussians <= len(fine) <= 1.1 * SETTINGS.gaussians
    assert len(fine) / 2 <= len(coarse) < len(fine)
    assert fine.gaussians.is_finite()
    assert coarse.gaussians.is_finite()


def test_trees_are_complete_at_any_time(arrays, trained, often):
    check_forest(trained.forest())
    # Before the forest is built at about 24, after that, and around 48, when the trees are settled.
    trainer = Trainer(arrays, WALLS, SHORT)
    for stop in (5, 28, 35, 47, 48, 49, 60):
        trainer.run(until=stop)
        assert trainer.iteration == stop
        check_forest(trainer.forest())


def test_children_follow_their_parents_through_a_change_of_density(arrays, often):
    """Children of removed nodes are left without a parent; the others keep theirs, wherever it is now."""
    trainer = Trainer(arrays, WALLS, SHORT)
    coarse, fine = trainer._layers
    # The coarse layer changes after its 5th step.
    while coarse.done < 4 or trainer._schedule[trainer.iteration] != 0:
        trainer.run(until=trainer.iteration + 1)
    coarse._optimizer.on_device.opacity_logits[[0, 5, 6]] = -50.0
    means, old = coarse.layer.gaussians.means.clone(), fine.layer.parent.long()
    trainer.run(until=trainer.iteration + 1)
    new = fine.layer.parent.long()
    kept = new != -1
    assert torch.equal(~kept, torch.isin(old, torch.tensor([0, 5, 6])) | (old == -1))
    # An optimizer step moves nodes by less than this; other nodes lie further away.
    moved = coarse.layer.gaussians.means[:, new[kept]] - means[:, old[kept]]
    assert moved.abs().max() < 0.02


def test_merged_nodes_move_a_quarter_of_what_seeds_do(arrays):
    trainer = Trainer(arrays, WALLS, SETTINGS)
    first = [int(np.argmax(trainer._schedule == number)) for number in (1, 0)]
    moved = []
    for number, iteration in zip((1, 0), first, strict=True):
        trainer.run(until=iteration)
        means = trainer.forest()[number].gaussians.means.clone()
        trainer.run(until=iteration + 1)
        pixel = pixel_footprint(trainer._layers[number].views)
        after = trainer._layers[number].layer.gaussians.means
        moved.append(float(((after - means).abs() / remoteness(means)).max()) / pixel)
    assert moved[1] == pytest.approx(0.25 * moved[0], rel=0.01)


def test_the_coarse_layer_looks_right_at_its_own_resolution(arrays, trained):
    small = reduced(wall(0.2), 2)
    coarse = trained.forest()[0].gaussians
    image = perceptual_from_radiance(
        render_differentiable(arrays, coarse, trained.place.camera(small.camera))
    ).clamp(0, 1)
    target = perceptual_from_radiance(torch.from_numpy(small.radiance)).clamp(0, 1)
    # Seen: 0.0058; an image of its mean colour has 0.068.
    assert float(((image - target) ** 2).mean()) < 0.15 * float(target.var())


@pytest.mark.parametrize("stop", [10, 33, 51])
def test_an_interrupted_training_ends_with_the_same_bits(arrays, short, often, stop):
    """Interrupted when density control is due, amid all layers, and after the trees are settled.

    So do two trainings with the same seed.
    """
    first = Trainer(arrays, WALLS, SHORT)
    first.run(until=stop)
    tensors, numbers = first.state()
    tensors = {name: tensor.clone() for name, tensor in tensors.items()}
    second = Trainer(arrays, WALLS, SHORT)
    second.restore(tensors, numbers)
    second.run()
    assert same(short, second)


@pytest.mark.parametrize(("until", "least"), [(8, 5), (25, 3)])
def test_the_number_of_steps_can_change(arrays, short, often, until, least):
    """Early on and amid all layers. All that depends on it follows: with the same number, nothing changes."""
    same_number, fewer = Trainer(arrays, WALLS, SHORT), Trainer(arrays, WALLS, SHORT)
    for trainer, last in ((same_number, 60), (fewer, 40)):
        trainer.run(until=until)
        trainer.last(last)
        trainer.run()
        assert trainer.iteration == trainer.settings.iterations == last
        check_forest(trainer.forest())
        assert all(layer.done == layer._steps for layer in trainer._layers)
    assert same(short, same_number)
    assert sum(layer.done for layer in fewer._layers) == 40
    assert min(layer.done for layer in fewer._layers) > least
    # As at the end of a training that was meant to have as many.
    whole = Trainer(arrays, WALLS, replace(SHORT, iterations=40))
    whole.run()
    counts = [[len(layer) for layer in trainer.forest()] for trainer in (fewer, whole)]
    np.testing.assert_allclose(*counts, rtol=0.1)


def test_what_has_changed_holds_after_an_interruption(arrays, often):
    """The next run is begun with the number that there was at last."""
    first = Trainer(arrays, WALLS, SHORT)
    first.run(until=25)
    first.last(40)
    first.run(until=31)
    tensors, numbers = first.state()
    tensors = {name: tensor.clone() for name, tensor in tensors.items()}
    second = Trainer(arrays, WALLS, replace(SHORT, iterations=40))
    second.restore(tensors, numbers)
    for trainer in (first, second):
        trainer.run()
    assert same(first, second)


def test_near_the_end_it_cannot(arrays, often):
    trainer = Trainer(arrays, WALLS, SHORT)
    trainer.run(until=20)
    with pytest.raises(ValueError, match="after 20 steps, there cannot be 28 in all any more"):
        trainer.last(28)
    trainer.run(until=43)
    with pytest.raises(ValueError, match="after 43 steps, there cannot be 100 in all any more"):
        trainer.last(100)


def test_another_seed_gives_another_forest(arrays, short, often):
    other = Trainer(arrays, WALLS, replace(SHORT, seed=1))
    other.run(until=1)
    first = Trainer(arrays, WALLS, SHORT)
    first.run(until=1)
    assert not same(first, other)


def test_progress_is_reported_after_each_step(arrays):
    steps = []
    trainer = Trainer(arrays, WALLS[:1], TrainingSettings(iterations=5, gaussians=50, layers=1, degree=0))
    trainer.run(steps.append, until=3)
    trainer.run(steps.append)
    assert steps == [1, 2, 3, 4, 5]


def test_the_finest_layer_is_trained_alone_and_then_as_often_as_others():
    """Of 3000 steps the first 1500; four layers share the others, 375 each (sd 17)."""
    assert set(training_schedule(TrainingSettings(layers=1)).tolist()) == {0}
    schedule = training_schedule(TrainingSettings())
    assert len(schedule) == 3000
    assert set(schedule[:1500].tolist()) == {3}
    counts = Counter(schedule[1500:].tolist())
    assert all(counts[layer] == pytest.approx(375, abs=5 * 17) for layer in range(4))


def test_a_checkpoint_of_other_settings_is_refused(arrays):
    first = Trainer(arrays, WALLS, SETTINGS)
    other = Trainer(arrays, WALLS, TrainingSettings(iterations=10, gaussians=900, layers=2, degree=1))
    with pytest.raises(ValueError, match="other settings"):
        other.restore(*first.state())


def test_a_closed_sphere_has_radiance_one_after_training(arrays):
    views = [closed_sphere(x) for x in (-0.3, 0.3)]
    trainer = Trainer(arrays, views, TrainingSettings(iterations=100, gaussians=1000, layers=1, degree=0))
    trainer.run()
    between = trainer.place.camera(closed_sphere(0.0).camera)
    image = render_differentiable(arrays, trainer.forest()[-1].gaussians, between).numpy()
    assert image.mean() == pytest.approx(1, abs=0.02)
    assert np.abs(image - 1).mean() < 0.03


@pytest.mark.parametrize("bad", [{"iterations": 0}, {"gaussians": -1}, {"degree": 4}, {"layers": 0}])
def test_senseless_settings_are_refused(bad):
    with pytest.raises(ValueError, match=r"must (be|have)"):
        TrainingSettings(**bad)


def test_the_coarsest_layer_holds_the_similaritys_window():
    """11 pixels are one layer, 22 two, 43 still two, 44 three; the shorter side counts."""
    sizes = [(10, 50), (11, 11), (21, 30), (22, 22), (43, 99), (99, 44), (0, 5)]
    assert [most_layers(*size) for size in sizes] == [0, 1, 1, 2, 2, 3, 0]


@pytest.mark.parametrize("iterations", [15, 30, 60])
def test_a_training_goes_on_from_a_forest(arrays, short, monkeypatch, iterations):
    """Trees stay whole, though nodes vanish after they settled, and density control acts at every step."""
    monkeypatch.setattr(density, "_EVERY", 1)
    start = forest_of(short.forest(), WALLS[0].camera.fy, "", "", short.place)
    settings = replace(SHORT, iterations=iterations, gaussians=600)
    trainer = Trainer(arrays, WALLS, settings, start)
    assert equal(trainer._layers[-1].layer.gaussians, start.finest)
    trainer.run(until=trainer._settling + 1)
    trainer._layers[0].layer.gaussians.opacity_logits[[0, 5, 6]] = -50.0
    trainer.run()
    check_forest(trainer.forest())
    assert len(trainer.forest()[-1]) > len(start.finest)
    assert trainer.place == start.place
