"""Training at the ends: scenes of any size and place, what is not finite, least settings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.camera import Camera, camera_from_pose
from splat.model.gaussians import Gaussians, perceptual_from_radiance
from splat.model.trees import check_forest
from splat.raster.differentiable import render_differentiable
from splat.training.gaussian_optimizer import GaussianOptimizer
from splat.training.loss import FrameTarget
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.training_view import TrainingView, in_half_precision
from tests.extremes import extreme
from tests.splat.samples import equal
from tests.splat.samples import gaussians as random_gaussians
from tests.splat.training import reference
from tests.splat.training.frames import SIZE, WALLS, made, pose, wall
from tests.splat.training.random_steps import random_steps

SETTINGS = TrainingSettings(iterations=60, gaussians=500, layers=2, degree=1)
# Long enough for the trees to be built and settled.
SHORT = replace(SETTINGS, iterations=30)
TINY = TrainingSettings(iterations=1, gaussians=1, layers=1, degree=0)


def elsewhere(view: TrainingView, scale: float = 1.0, offset: float = 0.0) -> TrainingView:
    """The same view of a scene that is scaled, then moved along all axes."""
    matrix = view.camera.camera_to_world
    matrix[:3, 3] = matrix[:3, 3] * scale + offset
    c = view.camera
    camera = camera_from_pose(matrix, c.width, c.height, c.fx, c.fy, c.cx, c.cy)
    return replace(view, camera=camera, distance=(view.distance * np.float64(scale)).astype(np.float32))


def telescopic(view: TrainingView, factor: float) -> TrainingView:
    """The same picture of the wall, from `factor` times as far away at as many times the focal length."""
    c = view.camera
    matrix = c.camera_to_world
    matrix[2, 3] *= factor
    camera = camera_from_pose(matrix, c.width, c.height, c.fx * factor, c.fy * factor, c.cx, c.cy)
    rays = camera.rays(camera.pixel_centres())
    distance = (3 * factor / rays[:, 2]).reshape(view.distance.shape)
    return replace(view, camera=camera, distance=distance.astype(np.float32))


def psnr(arrays, trainer: Trainer, view: TrainingView) -> float:
    """Of a view on the perceptual scale, in dB."""
    gaussians = trainer.forest()[-1].gaussians
    image = render_differentiable(arrays, gaussians, trainer.place.camera(view.camera))
    shown, target = (
        perceptual_from_radiance(i).clamp(0, 1) for i in (image, torch.from_numpy(view.radiance))
    )
    return float(-10 * torch.log10(((shown - target) ** 2).mean()))


def trained(arrays, views: list[TrainingView], settings: TrainingSettings = SETTINGS) -> Trainer:
    trainer = Trainer(arrays, views, settings)
    trainer.run()
    return trainer


@pytest.fixture(scope="module")
def ordinary(arrays) -> float:
    return psnr(arrays, trained(arrays, WALLS), wall(0.2))


@pytest.mark.parametrize(
    ("scale", "offset"),
    [
        pytest.param(
            s, o, marks=extreme(f"training {name}", given=given, expected="held-out PSNR within 0.4 dB")
        )
        for s, o, name, given in [
            (1e-4, 0.0, "at a scale of 1e-4", "an ordinary wall scaled by 1e-4"),
            (1e6, 0.0, "at a scale of 1e6", "an ordinary wall scaled by 1e6"),
            (1e-12, 0.0, "at a scale of 1e-12", "an ordinary wall scaled by 1e-12"),
            (1.0, 1e6, "1e6 from the origin", "an ordinary wall moved by 1e6"),
            (1e-4, 1e3, "small and far", "scaled by 1e-4 and moved by 1e3: 1e7 of its own sizes"),
        ]
    ],
)
def test_a_scene_of_any_size_and_place_is_learnt_as_well(arrays, ordinary, scale, offset, got):
    views = [elsewhere(view, scale, offset) for view in WALLS]
    found = psnr(arrays, trained(arrays, views), elsewhere(wall(0.2), scale, offset))
    assert got(found - ordinary, "+.2f") == pytest.approx(0, abs=0.4)


def test_frames_in_half_precision_are_learnt_as_well(arrays, ordinary):
    found = trained(arrays, [in_half_precision(view) for view in WALLS])
    assert psnr(arrays, found, wall(0.2)) == pytest.approx(ordinary, abs=0.4)


@extreme(
    "training in a field of view of 0.1 degrees",
    given="the ordinary pictures through a lens 500 times as long",
    expected="held-out PSNR within 0.4 dB",
)
def test_a_narrow_field_of_view_is_learnt_as_well(arrays, ordinary, got):
    # 32 pixels at 20,000 px are 0.09 degrees.
    found = trained(arrays, [telescopic(view, 500.0) for view in WALLS])
    assert got(psnr(arrays, found, telescopic(wall(0.2), 500.0)) - ordinary, "+.2f") == pytest.approx(
        0, abs=0.7
    )


@pytest.mark.parametrize(
    ("name", "spoilt"),
    [
        pytest.param(
            n, v, marks=extreme(f"training frame with {w}", given="1 of 4 frames", expected="left out")
        )
        for n, v, w in [
            ("radiance", np.nan, "NaN"),
            ("radiance", np.inf, "an infinite pixel"),
            ("distance", np.nan, "NaN as distance"),
            ("normal", np.nan, "NaN as normal"),
        ]
    ],
)
def test_a_frame_that_is_not_finite_is_left_out(arrays, name, spoilt, got):
    bad = getattr(WALLS[0], name).copy()
    bad.ravel()[7] = spoilt
    settings = replace(SETTINGS, iterations=6)
    trainer = trained(arrays, [WALLS[0], replace(WALLS[0], **{name: bad}), *WALLS[1:]], settings)
    without = trained(arrays, WALLS, settings)
    assert got(trainer.dropped) == 1
    assert without.dropped == 0
    assert equal(trainer.forest()[-1].gaussians, without.forest()[-1].gaussians)


@extreme("only spoilt frames", given="NaN in a pixel of each frame", expected="refused in one line")
def test_frames_none_of_which_is_finite_are_refused(arrays, got):
    radiance = WALLS[0].radiance.copy()
    radiance[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="none of 1 frames holds only finite numbers") as caught:
        Trainer(arrays, [replace(WALLS[0], radiance=radiance)], TINY)
    assert "\n" not in got(str(caught.value))


@extreme("training on the sky alone", given="infinite distances everywhere", expected="refused in one line")
def test_frames_without_a_surface_are_refused(arrays, got):
    sky = replace(WALLS[0], distance=np.full_like(WALLS[0].distance, np.inf))
    with pytest.raises(ValueError, match="no frame shows a surface at a finite distance") as caught:
        Trainer(arrays, [sky, sky], TINY)
    assert "\n" not in got(str(caught.value))


@extreme("12 layers in 32 pixels", given="frames of 32 x 32 pixels", expected="refused in one line")
def test_too_many_layers_are_refused(arrays, got):
    with pytest.raises(ValueError, match="32 x 32 pixels are too small for 12 layers") as caught:
        Trainer(arrays, WALLS, replace(SETTINGS, layers=12))
    assert "\n" not in got(str(caught.value))


def mostly_sky() -> TrainingView:
    distance = np.full_like(WALLS[0].distance, np.inf)
    distance[3, 4] = WALLS[0].distance[3, 4]
    return replace(WALLS[0], distance=distance)


def uniform(radiance: float) -> list[TrainingView]:
    return [replace(view, radiance=np.full_like(view.radiance, radiance)) for view in WALLS]


def sky_of(view: TrainingView) -> TrainingView:
    return replace(view, distance=np.full_like(view.distance, np.inf))


@pytest.mark.parametrize(
    ("views", "settings"),
    [
        pytest.param(v, s, marks=extreme(name, given=given, expected="a complete, finite forest"))
        for v, s, name, given in [
            (WALLS, TINY, "1 Gaussian and 1 step", "the least settings"),
            (WALLS[:1], replace(SETTINGS, iterations=1), "1 step and 2 layers", "1 view, 500 Gaussians"),
            (WALLS[:1], SHORT, "a single view", "30 steps of one frame"),
            ([WALLS[0]] * 3, SHORT, "identical views", "30 steps of three equal frames"),
            ([mostly_sky()], TINY, "one pixel of surface", "all other pixels show the sky"),
            ([*WALLS, sky_of(WALLS[0])], SHORT, "a view of the sky alone", "one of 4 views"),
            (uniform(0.0), SHORT, "training on black frames", "three views of radiance 0"),
            (uniform(1e6), SHORT, "training on radiance 1e6", "three views of radiance 1e6"),
            (uniform(1e30), SHORT, "training on radiance 1e30", "three views of radiance 1e30"),
            (uniform(1e-30), SHORT, "training on radiance 1e-30", "three views of radiance 1e-30"),
            (uniform(-0.01), SHORT, "training on negative radiance", "three views of radiance -0.01"),
        ]
    ],
)
def test_training_ends_finite(arrays, views, settings, got):
    trainer = trained(arrays, views, settings)
    layers = trainer.forest()
    check_forest(layers)
    assert all(layer.gaussians.is_finite() for layer in layers)
    assert trainer.skipped == 0
    got(f"{sum(map(len, layers))} nodes")


def test_a_layer_keeps_a_node_when_all_turn_transparent(arrays):
    settings = replace(SETTINGS, iterations=400)
    trainer = Trainer(arrays, uniform(0.0), settings)
    trainer.run(until=99)
    trainer.forest()[-1].gaussians.opacity_logits.fill_(-50.0)
    trainer.run(until=100)
    assert len(trainer.forest()[-1]) >= 1
    check_forest(trainer.forest())


@pytest.mark.parametrize(
    "factor",
    [
        pytest.param(f, marks=extreme(f"gradient {n}", given=f"a loss times {f}", expected="step left out"))
        for f, n in [
            (float("nan"), "of NaN"),
            (float("inf"), "of infinity"),
            (1e30, "whose square overflows"),
        ]
    ],
)
def test_a_step_that_is_not_finite_changes_nothing(factor, got):
    optimizer = GaussianOptimizer(random_gaussians(n=20), 0.01)
    everything = torch.arange(20)
    assert optimizer.step(optimizer.chosen(everything).means.square().sum(), 0.0)
    before = {name: tensor.clone() for name, tensor in optimizer.state().items()}
    # In the loss itself, then in its gradient alone.
    assert not optimizer.step(optimizer.chosen(everything).means.square().sum() * factor, 0.0)
    leaf = optimizer.chosen(everything).sh
    handle = leaf.register_hook(lambda gradient: gradient * factor)
    taken = got(optimizer.step(leaf.square().sum(), 0.0))
    handle.remove()
    assert not taken
    assert all(torch.equal(tensor, before[name]) for name, tensor in optimizer.state().items())
    assert optimizer.step(optimizer.chosen(everything).means.square().sum(), 0.0)


def test_skipped_steps_are_counted_and_kept_in_checkpoints(arrays, monkeypatch):
    trainer = Trainer(arrays, WALLS, replace(SETTINGS, iterations=10))
    trainer.run(until=2)
    with monkeypatch.context() as patch:
        patch.setattr(GaussianOptimizer, "step", lambda *arguments: False)
        trainer.run(until=5)
    assert trainer.skipped == 3
    tensors, numbers = trainer.state()
    other = Trainer(arrays, WALLS, replace(SETTINGS, iterations=10))
    other.restore(tensors, numbers)
    assert other.skipped == 3


def test_a_checkpoint_in_other_coordinates_is_refused(arrays):
    first = Trainer(arrays, WALLS, TINY)
    first.run()
    other = Trainer(arrays, [elsewhere(view, 2.0) for view in WALLS], TINY)
    with pytest.raises(ValueError, match="other coordinates"):
        other.restore(*first.state())


@extreme(
    "random training steps",
    given="scales, colours, cameras and rates over many decades; black, noisy and bright targets",
    expected="200 steps, none left out, all numbers finite",
)
def test_random_steps_stay_finite(arrays, got):
    steps = list(random_steps(arrays, 200, seed=1))
    skipped = sum(not step.taken for step in steps)
    assert got(f"{len(steps)} steps, {skipped} left out") == "200 steps, 0 left out"
    assert all(step.finite for step in steps)


@pytest.mark.long
@extreme(
    "10,000 random training steps",
    given="scales, colours, cameras and rates over many decades; black, noisy and bright targets",
    expected="10,000 steps, all numbers finite",
)
def test_ten_thousand_random_steps_stay_finite(arrays, got):
    steps = list(random_steps(arrays, 10_000, seed=0))
    got(f"{len(steps)} steps, {sum(not step.taken for step in steps)} left out")
    assert all(step.finite for step in steps)


def image(kind: str, side: int = 13) -> np.ndarray:
    noise = np.random.default_rng(len(kind)).uniform(size=(side, side, 3))
    return {
        "black": noise * 0,
        "nearly black": noise * 1e-6,
        "constant": noise * 0 + 0.5,
        "very bright": 1e6 * (1 + 0.01 * noise),
        "a lamp in the dark": np.where(noise > 0.8, 1e6, noise * 1e-4),
    }[kind]


PAIRS = [
    ("black", "black"),
    ("nearly black", "black"),
    ("constant", "black"),
    ("constant", "constant"),
    ("black", "very bright"),
    ("very bright", "very bright"),
    ("very bright", "black"),
    ("constant", "a lamp in the dark"),
]


@pytest.mark.parametrize(
    ("shown", "wanted"),
    [
        pytest.param(
            *pair,
            marks=extreme(
                f"loss of {pair[0]} against {pair[1]}",
                given="13 x 13 pixels in float32",
                expected="float64 within 2e-5, its gradient within 1 % of finite differences",
            ),
        )
        for pair in PAIRS
    ],
)
def test_loss_and_gradient_are_those_of_float64(arrays, shown, wanted, got):
    # Not quite equal where they are of one kind: at equality, the absolute difference has no gradient.
    values = image(shown) * (1 + 1e-2 * np.random.default_rng(5).uniform(size=(13, 13, 3)))
    target = torch.from_numpy(image(wanted))
    single = torch.from_numpy(values.astype(np.float32)).requires_grad_()
    loss, _ = FrameTarget(arrays, target.float()).loss(single)
    loss.backward()
    value = reference.loss(torch.from_numpy(values), target).item()
    assert got(abs(loss.item() - value), ".1e") < 2e-5
    # Along a few pixels, in steps relative to their radiance.
    gradient, expected = single.grad.numpy(), []
    chosen = [(0, 0, 0), (6, 6, 1), (12, 3, 2), (5, 9, 0)]
    for index in chosen:
        step = max(1e-5 * abs(values[index]), 1e-9)
        losses = []
        for sign in (-1, 1):
            moved = values.copy()
            moved[index] += sign * step
            losses.append(float(reference.loss(torch.from_numpy(moved), target)))
        expected.append((losses[1] - losses[0]) / (2 * step))
    found = np.array([gradient[index] for index in chosen])
    scale = np.abs(gradient).max() + np.abs(expected).max()
    # Black on black: the derivative of the absolute value at 0 is 0 for torch, and so are both differences.
    error = float(np.abs(found - expected).max() / scale) if scale else 0.0
    assert got(error, ".1e") < 1e-2


@extreme(
    "similarity at radiance 1e30",
    given="noise of 1 % on radiance 1e30 in float32",
    expected="float64 within 1e-4",
)
def test_similarity_does_not_cancel_where_all_is_bright(arrays, got):
    noise = np.random.default_rng(3).uniform(size=(2, 13, 13, 3))
    one, other = (1e30 * (1 + 0.01 * n) for n in noise)
    single = FrameTarget(arrays, torch.from_numpy(one).float()).loss(torch.from_numpy(other).float())[0]
    exact = reference.loss(torch.from_numpy(other), torch.from_numpy(one))
    assert got(abs(float(single) - float(exact)), ".1e") < 1e-4


@extreme(
    "image gradient before a bright target",
    given="4 Gaussians, targets of radiance 0 and 1e6",
    expected="finite differences of the optimizer's loss within 3 %",
)
def test_the_optimizers_path_has_the_right_gradient(arrays, got):
    camera = wall(0.0).camera
    gaussians = bright_gaussians()
    worst = 0.0
    for radiance in (0.0, 1e6):
        target = FrameTarget(arrays, torch.full((SIZE, SIZE, 3), radiance))
        sh = gaussians.sh.clone().requires_grad_()
        loss, _ = target.loss(render_differentiable(arrays, replace(gaussians, sh=sh), camera))
        loss.backward()
        for index in range(4):
            found, step = [], 0.02
            for sign in (-1, 1):
                moved = gaussians.sh.clone()
                moved[0, 0, index] += sign * step
                picture = render_differentiable(arrays, replace(gaussians, sh=moved), camera)
                found.append(float(target.loss(picture)[0]))
            expected = (found[1] - found[0]) / (2 * step)
            worst = max(worst, abs(float(sh.grad[0, 0, index]) - expected) / abs(expected))
    assert got(worst, ".1e") < 0.03


def bright_gaussians() -> Gaussians:
    return Gaussians(
        torch.tensor([[-0.6, 0.6, -0.6, 0.6], [-0.6, -0.6, 0.6, 0.6], [0.0, 0.0, 0.0, 0.0]]),
        torch.full((3, 4), -1.0),
        torch.tensor([[1.0], [0.0], [0.0], [0.0]]).repeat(1, 4),
        torch.full((4,), 1.0),
        torch.full((1, 3, 4), 1.0),
    )


def wide(camera: Camera) -> Camera:
    """179 degrees, over the same pixels."""
    focal = SIZE / 2 / np.tan(np.radians(179 / 2))
    return replace(camera, fx=focal, fy=focal)


@extreme(
    "training in a field of view of 179 degrees",
    given="a closed sphere of radius 3 and radiance 1",
    expected="radiance 1 within 5 % over the frame",
)
def test_a_wide_field_of_view_is_learnt(arrays, got):
    matrix = pose(0.0)
    matrix[2, 3] = -1
    camera = wide(camera_from_pose(matrix, SIZE, SIZE, 1, 1, SIZE / 2, SIZE / 2))
    rays = camera.rays(camera.pixel_centres())
    along = rays @ camera.position
    distance = -along + np.sqrt(along**2 - camera.position @ camera.position + 9)
    points = camera.position + rays * distance[:, None]
    view = made(camera, np.ones((SIZE**2, 3)), distance, (-points / 3).astype(np.float32))
    trainer = trained(arrays, [view], SETTINGS)
    shown = render_differentiable(arrays, trainer.forest()[-1].gaussians, trainer.place.camera(camera))
    assert got(float((shown - 1).abs().mean()), ".3f") < 0.05
