"""Training: it learns, repeats, goes on after an interruption, and places seeds where surfaces are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from compose.camera.camera import camera_from_pose
from splat.model.check import check_forest
from splat.model.gaussians import logarithmic_from_radiance, perceptual_from_radiance
from splat.raster.differentiable import render_differentiable
from splat.raster.harmonics import radiance_from_perceptual
from splat.training.initialization import TrainingView, seed_at, seed_from_views
from splat.training.layer import reduced
from splat.training.loss import Target
from splat.training.trainer import Trainer, TrainingSettings

SIZE = 32


def pose(x: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = [x, 0, -3]
    return matrix


def view(x: float) -> TrainingView:
    """A striped wall at z = 0 with a lamp of radiance 50 on it."""
    camera = camera_from_pose(pose(x), SIZE, SIZE, 40, 40, SIZE / 2, SIZE / 2)
    rays = camera.rays(camera.pixel_centres())
    distance = 3 / rays[:, 2]
    points = camera.position + rays * distance[:, None]
    stripe = np.where(np.floor(points[:, 0] * 3) % 2 == 0, 0.1, 0.6)
    colour = np.stack([stripe, stripe * 0.5, 0.3 + 0 * stripe], axis=1)
    colour[np.hypot(points[:, 0] - 0.4, points[:, 1]) < 0.25] = 50.0
    shape = (SIZE, SIZE)
    normal = np.tile(np.array([0, 0, -1], np.float32), (*shape, 1))
    return TrainingView(
        camera,
        colour.reshape(*shape, 3).astype(np.float32),
        distance.reshape(shape).astype(np.float32),
        normal,
    )


VIEWS = [view(x) for x in (-0.4, 0.0, 0.4)]
SETTINGS = TrainingSettings(iterations=400, gaussians=900, layers=2, degree=1)


@pytest.fixture(scope="module")
def trained(arrays) -> Trainer:
    trainer = Trainer(arrays, VIEWS, SETTINGS)
    trainer.run()
    return trainer


def same(a: Trainer, b: Trainer) -> bool:
    """Whether two forests are equal to the last bit."""
    pairs = zip(a.forest(), b.forest(), strict=True)
    return all(
        torch.equal(x.parent, y.parent)
        and all(
            torch.equal(u, v)
            for (_, u), (_, v) in zip(x.gaussians.tensors(), y.gaussians.tensors(), strict=True)
        )
        for x, y in pairs
    )


def test_it_learns_a_view_it_never_saw(arrays, trained):
    """The lamp's edge has no antialiasing in these frames and keeps an error; the rest must be learnt."""
    unseen = view(0.2)

    def error(trainer: Trainer) -> float:
        image = perceptual_from_radiance(
            render_differentiable(arrays, trainer.forest()[-1].gaussians, unseen.camera)
        )
        target = perceptual_from_radiance(torch.from_numpy(unseen.radiance))
        return float(((image.clamp(0, 1) - target.clamp(0, 1)) ** 2).mean())

    # Seen: 0.0047 of 0.034.
    assert error(trained) < 0.25 * error(Trainer(arrays, VIEWS, SETTINGS))


def test_a_lamp_stays_a_lamp(arrays, trained):
    image = render_differentiable(arrays, trained.forest()[-1].gaussians, VIEWS[1].camera)
    lamp = torch.from_numpy(VIEWS[1].radiance)[..., 0] > 1
    assert image[lamp].median() == pytest.approx(50, rel=0.15)


def test_density_control_reaches_the_number_that_was_asked_for(trained):
    coarse, fine = trained.forest()
    assert 0.9 * SETTINGS.gaussians <= len(fine) <= 1.1 * SETTINGS.gaussians
    assert len(fine) / 2 <= len(coarse) < len(fine)
    assert fine.gaussians.is_finite()
    assert coarse.gaussians.is_finite()


def test_a_trained_forest_has_complete_trees(arrays, trained):
    check_forest(trained.forest())
    half_way = Trainer(arrays, VIEWS, SETTINGS)
    half_way.run(until=250)
    check_forest(half_way.forest())


def test_the_coarse_layer_looks_right_at_its_own_resolution(arrays, trained):
    small = reduced(view(0.2), 2)
    coarse = trained.forest()[0].gaussians
    image = perceptual_from_radiance(render_differentiable(arrays, coarse, small.camera)).clamp(0, 1)
    target = perceptual_from_radiance(torch.from_numpy(small.radiance)).clamp(0, 1)
    # Seen: 0.0058; a picture of its mean colour has 0.068.
    assert float(((image - target) ** 2).mean()) < 0.15 * float(target.var())


def test_a_reduced_view_is_the_mean_of_its_pixels():
    full = view(0.0)
    small = reduced(full, 4)
    assert (small.camera.width, small.camera.height) == (SIZE // 4, SIZE // 4)
    np.testing.assert_allclose(small.radiance[1, 2], full.radiance[4:8, 8:12].mean(axis=(0, 1)), rtol=1e-5)
    point = np.array([[0.1, 0.2, 0.0]])
    np.testing.assert_allclose(small.camera.project(point)[0] * 4, full.camera.project(point)[0])


def test_the_same_seed_gives_the_same_bits(arrays, trained):
    again = Trainer(arrays, VIEWS, SETTINGS)
    again.run()
    assert same(trained, again)


@pytest.mark.parametrize("stop", [1, 99, 160, 330])
def test_an_interrupted_training_ends_with_the_same_bits(arrays, trained, stop):
    first = Trainer(arrays, VIEWS, SETTINGS)
    first.run(until=stop)
    tensors, numbers = first.state()
    tensors = {name: tensor.clone() for name, tensor in tensors.items()}
    second = Trainer(arrays, VIEWS, SETTINGS)
    second.restore(tensors, numbers)
    second.run()
    assert same(trained, second)


def test_a_checkpoint_of_other_settings_is_refused(arrays):
    first = Trainer(arrays, VIEWS, SETTINGS)
    other = Trainer(arrays, VIEWS, TrainingSettings(iterations=10, gaussians=900, layers=2, degree=1))
    with pytest.raises(ValueError, match="other settings"):
        other.restore(*first.state())


def test_seeds_lie_on_the_surface_with_its_colour(arrays):
    seeds = seed_at(VIEWS[0], np.arange(SIZE * SIZE), 0.6, degree=1)
    np.testing.assert_allclose(seeds.means[2].numpy(), 0, atol=1e-5)
    radiance = radiance_from_perceptual(
        arrays.plain.Float(0.5 + seeds.sh[0, 0] * 0.28209479177387814)
    ).torch()
    np.testing.assert_allclose(radiance, VIEWS[0].radiance.reshape(-1, 3)[:, 0], rtol=1e-4)
    # Thin along the normal, -z: the third principal axis, turned by the quaternion, is the normal.
    w, x, y, z = seeds.rotations[:, 0].tolist()
    axis = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    np.testing.assert_allclose(np.abs(axis), [0, 0, 1], atol=1e-6)
    assert (seeds.log_scales[2] < seeds.log_scales[0]).all()


def test_nothing_hit_gives_no_seed():
    empty = TrainingView(
        VIEWS[0].camera, VIEWS[0].radiance, np.full((SIZE, SIZE), np.inf, np.float32), VIEWS[0].normal
    )
    assert len(seed_from_views([empty, VIEWS[1]], 200, 0, np.random.default_rng(0))) == 100


def test_the_curves_are_each_others_inverse(arrays):
    radiance = torch.tensor([0.0, 0.001, 0.2, 1.0, 7.0, 12_000.0])
    perceptual = perceptual_from_radiance(radiance)
    back = radiance_from_perceptual(arrays.plain.Float(perceptual)).torch()
    torch.testing.assert_close(back, radiance, rtol=1e-4, atol=1e-7)
    # sRGB of 0.2 is 0.4845; a radiance of e lies 1.055 / 2.4 above 1.
    assert perceptual[2].item() == pytest.approx(0.4845, abs=1e-4)
    assert logarithmic_from_radiance(torch.tensor(float(np.e))).item() == pytest.approx(1 + 1.055 / 2.4)


def test_ssim_is_that_of_scikit_image():
    from skimage.metrics import structural_similarity

    rng = np.random.default_rng(0)
    a, b = rng.uniform(size=(2, 40, 30, 3)).astype(np.float32)
    target = Target(torch.from_numpy(b))
    expected = structural_similarity(
        a,
        target.seen.numpy(),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
        full=True,
    )[1][5:-5, 5:-5].mean()
    assert target.ssim(torch.from_numpy(a)).item() == pytest.approx(expected, abs=1e-5)


def test_the_losss_gradient_equals_finite_differences():
    rng = np.random.default_rng(0)
    image = torch.tensor(rng.uniform(0.05, 3, (20, 18, 3)), dtype=torch.float64, requires_grad=True)
    target = Target(torch.tensor(rng.uniform(0.05, 3, (20, 18, 3)), dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda x: target.loss(x)[0], image, atol=1e-6)


def test_a_closed_sphere_has_radiance_one_after_training(arrays, backend):
    """The furnace of the path tracer's tests, learnt from its frames."""
    from pathtrace.dataset.rendering import render_frame
    from pathtrace.scene.scene import load_scene
    from pathtrace.trace.tracer import Tracer
    from tests import small

    scene = load_scene(small.furnace(), max_depth=40)
    tracer = Tracer(scene)
    frames = [render_frame(tracer, scene.camera, 8, seed) for seed in range(2)]
    views = [TrainingView(scene.camera, f.radiance, f.unfolded, f.normal) for f in frames]
    trainer = Trainer(arrays, views, TrainingSettings(iterations=150, gaussians=1000, layers=1, degree=0))
    trainer.run()
    image = render_differentiable(arrays, trainer.forest()[-1].gaussians, scene.camera).numpy()
    assert image.mean() == pytest.approx(1, abs=0.02)
    assert np.abs(image - 1).mean() < 0.03


@pytest.mark.parametrize("bad", [{"iterations": 0}, {"gaussians": -1}, {"degree": 4}, {"layers": 0}])
def test_senseless_settings_are_refused(bad):
    with pytest.raises(ValueError, match=r"must (be|have)"):
        TrainingSettings(**bad)
