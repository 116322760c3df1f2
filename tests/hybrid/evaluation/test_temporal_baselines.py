"""TAA and SVGF: each kernel against loops over pixels in float64, and whole frames."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from hybrid.evaluation import temporal_baselines as module
from hybrid.evaluation.temporal_baselines import (
    Guides,
    Svgf,
    TemporalAntialiasing,
    TracedFrame,
    accumulated,
    reprojected,
    variance_of,
    wavelet,
)
from hybrid.measure.reference import reference
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer
from tests import small

HEIGHT, WIDTH = 7, 9
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
KERNEL = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)


def tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(values.astype(np.float32))


@pytest.fixture
def surfaces() -> tuple[np.ndarray, np.ndarray]:
    """Depth (H, W) and normal (H, W, 3): a slanted wall, one behind it that is turned, and a bit of sky."""
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    depth = 2 + 0.02 * x + 0.05 * y
    normal = np.broadcast_to(np.array([0.0, 0.6, -0.8]), (HEIGHT, WIDTH, 3)).copy()
    depth[:, 5:], normal[:, 5:] = depth[:, 5:] + 1.5, (0.0, 0.59, -np.sqrt(1 - 0.59**2))
    depth[:2, 7:], normal[:2, 7:] = 1e18, 0
    return depth, normal


@pytest.fixture
def guides(surfaces) -> Guides:
    depth, normal = surfaces
    return Guides.of(tensor(depth)[None], tensor(normal).permute(2, 0, 1))


def gradients(depth: np.ndarray) -> np.ndarray:
    """(H, W, 2) the smaller difference to a neighbour within the frame, along x and y."""
    found = np.zeros((*depth.shape, 2))
    for i, j in np.ndindex(depth.shape):
        for axis, (di, dj) in enumerate(((0, 1), (1, 0))):
            steps = []
            if i - di >= 0 and j - dj >= 0:
                steps.append(depth[i, j] - depth[i - di, j - dj])
            if i + di < depth.shape[0] and j + dj < depth.shape[1]:
                steps.append(depth[i + di, j + dj] - depth[i, j])
            found[i, j, axis] = min(steps, key=abs)
    return found


def weight(depth, normal, slope, p, q) -> float:
    """w_z w_n of two pixels, 0 outside the frame."""
    if p == q:
        return 1.0
    if not (0 <= q[0] < HEIGHT and 0 <= q[1] < WIDTH):
        return 0.0
    along = abs(slope[p] @ np.array([q[1] - p[1], q[0] - p[0]]))
    nearness = np.exp(-abs(depth[p] - depth[q]) / (along + 1e-3 * depth[p]))
    return float(nearness * max(0.0, normal[p] @ normal[q]) ** 128)


def test_the_gradient_of_depth_does_not_cross_edges(guides, surfaces):
    expected = gradients(surfaces[0])
    found = guides.gradient.permute(1, 2, 0).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert abs(expected[3, 4, 0] - 0.02) < 1e-9


@pytest.mark.parametrize("step", [1, 2, 4])
def test_a_level_of_the_wavelet_is_that_of_the_paper(guides, surfaces, step):
    depth, normal = surfaces
    rng, slope = small.rng(step), gradients(depth)
    light = rng.uniform(0.2, 0.8, (HEIGHT, WIDTH, 3))
    variance = rng.uniform(0, 0.05, (HEIGHT, WIDTH))
    image, left = np.zeros_like(light), np.zeros_like(variance)
    padded = np.pad(variance, 1, mode="edge")
    for i, j in np.ndindex(HEIGHT, WIDTH):
        binomial = np.outer((1, 2, 1), (1, 2, 1)) / 16
        deviation = np.sqrt((padded[i : i + 3, j : j + 3] * binomial).sum())
        total = 0.0
        for a, b in itertools.product(range(-2, 3), repeat=2):
            q = i + a * step, j + b * step
            share = weight(depth, normal, slope, (i, j), q)
            if share == 0:
                continue
            apart = abs(LUMINANCE @ light[i, j] - LUMINANCE @ light[q])
            share *= np.exp(-apart / (4 * deviation + 1e-10)) * KERNEL[a + 2] * KERNEL[b + 2]
            total += share
            image[i, j] += share * light[q]
            left[i, j] += share**2 * variance[q]
        image[i, j] /= total
        left[i, j] /= total**2
    planes = tensor(light).permute(2, 0, 1)
    found, found_left = wavelet(planes, tensor(variance)[None], guides, step)
    np.testing.assert_allclose(found.permute(1, 2, 0).numpy(), image, atol=2e-5)
    np.testing.assert_allclose(found_left[0].numpy(), left, atol=2e-5)
    # What was averaged is less noisy, but the sky has nothing beside it.
    assert left[3, 3] < variance[3, 3]
    np.testing.assert_allclose(image[0, 8], light[0, 8])


def test_the_variance_of_young_pixels_is_that_around_them(guides, surfaces):
    depth, normal = surfaces
    rng, slope = small.rng(), gradients(depth)
    first = rng.uniform(0.2, 0.8, (HEIGHT, WIDTH))
    moments = np.stack([first, first**2 + rng.uniform(0, 0.02, first.shape)])
    frames = np.where(np.arange(WIDTH) % 2, 2.0, 9.0) * np.ones((HEIGHT, 1))
    expected = moments[1] - first**2
    for i, j in np.argwhere(frames < 4):
        total, sums = 0.0, np.zeros(2)
        for a, b in itertools.product(range(-3, 4), repeat=2):
            share = weight(depth, normal, slope, (i, j), (i + a, j + b))
            if share:
                total += share
                sums += share * moments[:, i + a, j + b]
        mean, square = sums / total
        expected[i, j] = max(0.0, square - mean**2) * 4 / frames[i, j]
    found = variance_of(tensor(moments), tensor(frames)[None], guides)[0].numpy()
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_history_comes_from_the_same_surface_only(guides, surfaces):
    """Everything has moved by 0.75 and 0.25 pixels."""
    depth, normal = surfaces
    history = small.rng().uniform(size=(HEIGHT, WIDTH, 2))
    slope = np.abs(gradients(depth)).max(axis=2)
    places = np.stack(np.meshgrid(np.arange(WIDTH) + 1.25, np.arange(HEIGHT) + 0.75), axis=2)
    expected = np.zeros_like(history)
    for i, j in np.ndindex(HEIGHT, WIDTH):
        total = 0.0
        for a, b in itertools.product(range(2), repeat=2):
            q = i + a, j + b
            if q[0] >= HEIGHT or q[1] >= WIDTH:
                continue
            near = abs(depth[q] - depth[i, j]) <= 2 * slope[i, j] + 0.01 * depth[i, j]
            sky = not normal[q].any() and not normal[i, j].any()
            if near and (normal[q] @ normal[i, j] >= 0.9 or sky):
                share = (0.25 if a else 0.75) * (0.75 if b else 0.25)
                total += share
                expected[i, j] += share * history[q]
        expected[i, j] = expected[i, j] / total if total > 0.01 else 0
    planes = tensor(history).permute(2, 0, 1)
    found = reprojected(planes, guides, guides, tensor(places), tensor(depth)[None])
    np.testing.assert_allclose(found.permute(1, 2, 0).numpy(), expected, atol=1e-5)
    # Beside the edge, one column is left; what has been uncovered has none.
    np.testing.assert_allclose(expected[3, 4], 0.75 * history[3, 4] + 0.25 * history[4, 4])
    hidden = reprojected(planes, guides, guides, tensor(places), tensor(depth + 1)[None])
    assert not hidden[:, 3, 3].any()


def test_history_is_clipped_to_what_is_around_a_pixel():
    """Whole pixels aside, where bicubic interpolation is exact; the last column came from beyond."""
    rng = small.rng()
    new, old = rng.uniform(0.3, 0.7, (2, HEIGHT, WIDTH, 3))
    places = np.stack(np.meshgrid(np.arange(WIDTH) + 1.5, np.arange(HEIGHT) + 0.5), axis=2)
    matrix = np.array([[1, 2, 1], [2, 0, -2], [-1, 2, -1]]) / 4
    colours = new @ matrix.T
    padded = np.pad(colours, ((1, 1), (1, 1), (0, 0)), mode="edge")
    expected = new.copy()
    for i, j in np.ndindex(HEIGHT, WIDTH - 1):
        around = padded[i : i + 3, j : j + 3].reshape(9, 3)
        mean, half = around.mean(axis=0), around.std(axis=0)
        offset = matrix @ old[i, j + 1] - mean
        clipped = mean + offset / max(1.0, float(np.max(np.abs(offset) / half)))
        expected[i, j] = np.linalg.inv(matrix) @ (0.9 * clipped + 0.1 * colours[i, j])
    found = accumulated(tensor(new).permute(2, 0, 1), tensor(old).permute(2, 0, 1), tensor(places), 0.1)
    np.testing.assert_allclose(found.permute(1, 2, 0).numpy(), expected, atol=2e-5)


@pytest.fixture(scope="module")
def tracer(backend) -> Tracer:
    return Tracer(load_scene(small.corner()))


def test_what_stands_still_was_where_it_is(tracer):
    camera = tracer.scene.camera.resized(32, 24)
    traced = TracedFrame.of(tracer, camera, 3, 3)
    places, depth = traced.places_in(camera)
    np.testing.assert_array_equal(places.reshape(-1, 2).numpy(), camera.pixel_centres().astype(np.float32))
    np.testing.assert_allclose(depth.numpy(), traced.depth.numpy(), rtol=1e-6)
    again = TracedFrame.of(tracer, camera, 3, 3)
    assert torch.equal(traced.radiance, again.radiance)


def test_what_a_moved_camera_sees_was_where_its_ray_ends(tracer):
    """Positions are those of hits, each at the same offset within its pixel in both views."""
    camera = tracer.scene.camera.resized(32, 24)
    last = camera.moved_right(0.05)
    traced = TracedFrame.of(tracer, camera, 0, 0)
    places, depth = traced.places_in(last)
    x = traced.position @ last.world_to_camera[:3, :3].T + last.world_to_camera[:3, 3]
    offset = traced.camera.project(traced.position)[0] - camera.pixel_centres()
    expected = last.fx * x[:, 0] / x[:, 2] + last.cx - offset[:, 0]
    np.testing.assert_allclose(places[..., 0].numpy().ravel(), expected, atol=1e-3)
    np.testing.assert_allclose(depth.numpy().ravel(), x[:, 2], rtol=1e-5)
    # Halves of the first numbers in bases 2 and 3: the same offset everywhere.
    np.testing.assert_allclose(offset, np.tile([0.0, 1 / 3 - 0.5], (len(offset), 1)), atol=1e-3)
    assert np.abs(places[..., 0].numpy().ravel() - camera.pixel_centres()[:, 0]).max() > 0.5


@pytest.mark.parametrize("made", [TemporalAntialiasing, Svgf])
@pytest.mark.parametrize("walks", [False, True])
def test_frames_get_better_than_single_paths(tracer, made, walks):
    camera = tracer.scene.camera.resized(48, 36)
    cameras = [camera.moved_right(0.004 * number * walks) for number in range(10)]
    truth = reference(tracer, cameras[-1], 64, 1).radiance
    method = made()
    for number, view in enumerate(cameras):
        traced = TracedFrame.of(tracer, view, number, number)
        image = method.frame(traced)
    noisy = traced.radiance.permute(1, 2, 0).numpy()
    # As far as a display shows them: a lamp's edge would outweigh everything.
    shown, *others = (np.minimum(one, 1) for one in (truth, image, noisy))
    errors = [float(np.mean(np.abs(one - shown))) for one in others]
    assert errors[0] < 0.6 * errors[1]
    method.forget()
    assert np.array_equal(method.frame(traced), made().frame(traced))


def test_a_frame_of_another_size_begins_anew(tracer):
    cameras = [tracer.scene.camera.resized(*size) for size in ((32, 24), (24, 16))]
    frames = [TracedFrame.of(tracer, camera, 0, 0) for camera in cameras]
    for made in (Svgf, TemporalAntialiasing):
        method = made()
        images = [method.frame(frame) for frame in frames]
        assert [image.shape for image in images] == [(24, 32, 3), (16, 24, 3)]
        assert np.array_equal(images[1], made().frame(frames[1]))


def test_albedo_is_not_filtered(tracer):
    """Illumination that is the same everywhere leaves the texture as it is."""
    camera = tracer.scene.camera.resized(32, 24)
    traced = TracedFrame.of(tracer, camera, 0, 0)
    albedo = tensor(small.rng().uniform(0.1, 0.9, (3, 24, 32)))
    textured = replace(traced, albedo=albedo, radiance=0.5 * albedo)
    found = Svgf().frame(textured)
    np.testing.assert_allclose(found, textured.radiance.permute(1, 2, 0).numpy(), atol=1e-4)


def test_offsets_fill_the_pixel():
    points = [[module._halton(n + 1, base) for base in (2, 3)] for n in range(16)]
    assert len({tuple(point) for point in points}) == 16
    np.testing.assert_allclose(points[:3], [[0.5, 1 / 3], [0.25, 2 / 3], [0.75, 1 / 9]])
