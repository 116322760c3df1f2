"""Training of fields: they learn what moves, resume with the same bits, and survive a bad gradient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.camera import Camera
from splat.model.choices import FieldKind, MotionModel
from splat.model.forest import forest_of
from splat.model.motion import LearnedMotion
from splat.raster.differentiable import render_differentiable
from splat.training.field_training import FieldOptimizer
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.training_view import TrainingView
from tests.extremes import extreme
from tests.splat.training.test_moving import VIEWS, scene

LEARNED = [model for model in MotionModel if model.field is not None]
SETTINGS = TrainingSettings(iterations=100, gaussians=900, layers=1, degree=0, seed=3)


def error(arrays, trainer: Trainer, view: TrainingView) -> float:
    """PSNR in dB of what the field makes of the Gaussians at a view's time, within 0..1."""
    layer = trainer.forest()[-1]
    assert trainer.motion is not None
    with torch.no_grad():
        gaussians = trainer.motion.shown(layer.gaussians, layer.semantic, view.time)
    image = render_differentiable(arrays, gaussians, trainer.place.camera(view.camera)).numpy()
    return float(-10 * np.log10(np.mean((np.clip(image, 0, 1) - np.clip(view.radiance, 0, 1)) ** 2)))


@pytest.mark.parametrize("kind", list(FieldKind))
def test_a_field_learns_a_course(kind):
    """Where points are at some times, and with it where they are between these."""
    motion = LearnedMotion.begun(kind, torch.full((3,), -1.0), torch.full((3,), 2.0), 0)
    steps, generator = 400, torch.Generator().manual_seed(0)
    optimizer = FieldOptimizer(motion, steps)
    points = torch.rand(3, 50, generator=generator)

    def way(time: float) -> torch.Tensor:
        return torch.stack([time * points[1], torch.full((50,), 0.5 * time**2), -0.3 * time * points[0]])

    def off(time: float) -> torch.Tensor:
        return (motion.field(points, time).shifts - way(time)).square().mean()

    before = [float(off(time).detach()) for time in (0.33, 0.71, 0.97)]
    for step in range(steps):
        off(float(torch.rand(1, generator=generator))).backward()
        optimizer.step(step, valid=True)
    assert max(float(off(t).detach()) / was for t, was in zip((0.33, 0.71, 0.97), before, strict=True)) < 0.2


def test_a_field_learns_what_moves_in_frames(arrays):
    """The frames that it was trained on are shown better than by Gaussians that stand still."""
    found = []
    for motion in (MotionModel.D_GS_OF_DYNAMIC, MotionModel.KNOWN):
        learned = motion.field is not None
        views = VIEWS if learned else [replace(view, instance=None) for view in VIEWS]
        trainer = Trainer(arrays, views, replace(SETTINGS, motion=motion))
        trainer.run()
        if not learned:
            trainer.motion = LearnedMotion.begun(FieldKind.D_GS, torch.zeros(3), torch.ones(3), 0)
        found.append(np.mean([error(arrays, trainer, view) for view in VIEWS]))
    assert found[0] > found[1] + 0.4


def test_only_what_frames_show_to_move_is_deformed_if_so_asked(arrays):
    """All else stays background."""
    for model, everything in ((MotionModel.D_GS, True), (MotionModel.D_GS_OF_DYNAMIC, False)):
        trainer = Trainer(arrays, VIEWS, replace(SETTINGS, iterations=10, motion=model))
        trainer.run()
        dynamic = trainer.forest()[-1].dynamic
        assert bool(dynamic.all()) == everything
        assert bool(dynamic.any())


@pytest.mark.parametrize("model", LEARNED)
def test_training_resumes_with_the_same_bits(arrays, model):
    settings = replace(SETTINGS, iterations=12, layers=2, motion=model)
    straight = Trainer(arrays, VIEWS, settings)
    straight.run()
    first = Trainer(arrays, VIEWS, settings)
    first.run(until=7)
    tensors, numbers = first.state()
    tensors = {name: tensor.clone() for name, tensor in tensors.items()}
    second = Trainer(arrays, VIEWS, settings)
    second.restore(tensors, numbers)
    second.run()
    assert second.motion is not None
    assert straight.motion is not None
    for name, tensor in straight.motion.tensors().items():
        torch.testing.assert_close(second.motion.tensors()[name], tensor, rtol=0, atol=0)
    expected, found = (t.forest()[-1].gaussians.means for t in (straight, second))
    torch.testing.assert_close(found, expected, rtol=0, atol=0)


@pytest.mark.parametrize("bad", ["loss", "gradient"])
def test_a_step_that_is_not_finite_changes_nothing(bad):
    motion = LearnedMotion.begun(FieldKind.D_GS, torch.zeros(3), torch.ones(3), 0)
    optimizer = FieldOptimizer(motion, 10)
    before = {name: tensor.clone() for name, tensor in motion.tensors().items()}
    found = motion.field(torch.rand(3, 5), 0.5)
    (found.shifts.sum() * (float("nan") if bad == "gradient" else 1.0)).backward()
    optimizer.step(5, valid=bad == "gradient")
    for name, tensor in motion.tensors().items():
        torch.testing.assert_close(tensor, before[name], rtol=0, atol=0)
    assert all(parameter.grad is None for parameter in motion.field.parameters())


def apart(means: np.ndarray, camera: Camera) -> torch.Tensor:
    """Indices of points (N, 3) that are not as far from a camera as another up to rounding.

    The order of those that are is nobody's.
    """
    depth = (means - camera.position) @ camera.camera_to_world[:3, 2]
    order = np.argsort(depth)
    gaps = np.diff(depth[order], prepend=-np.inf)
    return torch.from_numpy(np.sort(order[gaps > 1e-5 * np.abs(depth[order])]))


@pytest.mark.parametrize("kind", list(FieldKind))
def test_forests_with_a_learned_motion_are_stored_and_drawn(arrays, kind, tmp_path):
    """What is read again is drawn as what training has drawn."""
    from splat.io.forest_file import load_forest, save_forest
    from splat.lod.forest_renderer import ForestRenderer

    model = next(model for model in LEARNED if model.field is kind)
    settings = replace(SETTINGS, iterations=60, motion=model, gaussians=SETTINGS.gaussians // 2)
    trainer = Trainer(arrays, VIEWS, settings)
    trainer.run()
    view = scene(0.1, 0.7)
    camera = trainer.place.camera(view.camera)
    layer = trainer.forest()[-1]
    with torch.no_grad():
        moved = trainer.motion.shown(layer.gaussians, layer.semantic, view.time)
    layer = layer.select(apart(moved.means.double().numpy().T, camera))
    forest = forest_of([layer], view.camera.fy, "card", "0" * 16, trainer.place, trainer.motion)
    save_forest(tmp_path / "f", forest)
    back = load_forest(tmp_path / "f")
    assert back.digest() == forest.digest()
    renderer = ForestRenderer(arrays, back)
    renderer.set_time(view.time)
    drawn = renderer.render_layer(view.camera, 1).numpy()
    with torch.no_grad():
        moved = trainer.motion.shown(layer.gaussians, layer.semantic, view.time)
    expected = render_differentiable(arrays, moved, camera).numpy()
    np.testing.assert_allclose(drawn, expected, atol=2e-3, rtol=1e-7 if arrays.device.type == "cpu" else 2e-3)


@extreme(
    "a damaged field",
    given="tensors missing, of another shape, of no kind, or NaN",
    expected="refused by name",
)
def test_a_damaged_field_is_refused(arrays, tmp_path, got):
    from compose.base.errors import UserError
    from splat.io.forest_file import load_forest, save_forest

    trainer = Trainer(arrays, VIEWS, replace(SETTINGS, iterations=3, motion=MotionModel.HEX_PLANE))
    trainer.run()
    motion = trainer.motion
    assert isinstance(motion, LearnedMotion)
    forest = forest_of(trainer.forest(), 50.0, "card", "0" * 16, trainer.place, motion)
    whole = motion.tensors()
    mix = "4dgs.mix.bias"
    damages = [
        {name: tensor for name, tensor in whole.items() if name != mix},
        {**whole, mix: torch.zeros(3)},
        {name.replace("4dgs", "5dgs"): tensor for name, tensor in whole.items()},
        {**whole, mix: torch.full_like(whole[mix], float("nan"))},
    ]
    refused = 0
    for number, tensors in enumerate(damages):
        file = tmp_path / f"{number}"
        motion.tensors = lambda tensors=tensors: tensors  # type: ignore[method-assign, misc]
        save_forest(file, forest)
        with pytest.raises(UserError, match="damaged forest file"):
            load_forest(file)
        refused += 1
    assert got(refused) == len(damages)
