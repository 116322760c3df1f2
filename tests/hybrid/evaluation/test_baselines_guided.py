"""Enlarged frames guided by first hits at full resolution."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from hybrid.evaluation.baselines_guided import Guided, divided, edge_aware, first_hits, multiplied
from hybrid.evaluation.baselines_traced import Enlarged, FullTrace, enlargement
from hybrid.measure.image_metrics import ssim
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.first_hit import AuxiliaryFeatures
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
SMALL, LARGE = (5, 6), (11, 14)
POSE = np.array([[1.0, 0, 0, 0.3], [0, 1, 0, -0.2], [0, 0, 1, 0.1], [0, 0, 0, 1]])
CAMERA = Camera(POSE, 14, 11, 12.0, 12.0, 7.0, 5.5)


@pytest.fixture(scope="module")
def tracer(backend) -> Tracer:
    return Tracer(load_scene("cornell"))


def features(rng: np.random.Generator, size: tuple[int, int]) -> dict[str, np.ndarray]:
    """(H, W, 3) each, of two surfaces side by side with some scatter, so that weights differ."""
    side = (np.arange(size[1]) >= size[1] / 2)[None, :, None]
    shape = (*size, 3)
    return {
        "albedo": np.where(side, 0.6, 0.5) + rng.normal(0, 0.03, shape),
        "normal": np.where(side, [0, 0.2, -1], [0, 0, -1]) + rng.normal(0, 0.1, shape),
        "position": np.array([0, 0, 4.0]) + rng.normal(0, 0.5, shape),
    }


def on_device(values: dict[str, np.ndarray]) -> AuxiliaryFeatures:
    channels = {
        name: [mi.Float(np.ascontiguousarray(of[..., c], np.float32).ravel()) for c in range(3)]
        for name, of in values.items()
    }
    return AuxiliaryFeatures(**channels, gloss=mi.Float(0))


def plain(image: np.ndarray, few: dict, many: dict, by_albedo: bool) -> np.ndarray:
    """Kopf et al.'s mean, pixel by pixel in float64."""
    found = np.zeros((*LARGE, image.shape[2]))
    side_per_distance = LARGE[0] / SMALL[0] / CAMERA.fy
    for row, column in np.ndindex(*LARGE):
        y, x = ((at + 0.5) * n / m - 0.5 for at, n, m in zip((row, column), SMALL, LARGE, strict=True))
        own = {name: of[row, column] for name, of in many.items()}
        total = 0.0
        for i in range(round(y) - 1, round(y) + 2):
            for j in range(round(x) - 1, round(x) + 2):
                at = np.clip(i, 0, SMALL[0] - 1), np.clip(j, 0, SMALL[1] - 1)
                side = side_per_distance * np.linalg.norm(own["position"] - CAMERA.camera_to_world[:3, 3])
                apart = (own["normal"] @ (few["position"][at] - own["position"]) / side) ** 2
                apart += ((few["normal"][at] - own["normal"]) ** 2).sum() / 0.15**2
                if by_albedo:
                    apart += ((few["albedo"][at] - own["albedo"]) ** 2).sum() / 0.05**2
                weight = np.exp(-0.5 * ((i - y) ** 2 + (j - x) ** 2) / 0.6**2) * (np.exp(-0.5 * apart) + 1e-3)
                found[row, column] += weight * image[at]
                total += weight
        found[row, column] /= total
    return found


@pytest.mark.parametrize("by_albedo", [False, True])
def test_edge_aware_means_are_those_of_kopf(by_albedo):
    rng = small.rng()
    few, many = features(rng, SMALL), features(rng, LARGE)
    image = rng.uniform(0, 2, (*SMALL, 4)).astype(np.float32)
    found = edge_aware(image, on_device(few), on_device(many), CAMERA, by_albedo)
    np.testing.assert_allclose(found, plain(image, few, many, by_albedo), rtol=2e-4)


def test_texture_comes_back_and_light_of_lamps_and_sky_does_not_leak():
    """Left half: even light on a texture of single pixels. Right half: sky of another radiance, no albedo."""
    rng = small.rng()
    albedo = rng.uniform(0.05, 0.9, (16, 32, 3)).astype(np.float32)
    albedo[:, 16:] = 0
    coverage = (albedo[..., :1] > 0).astype(np.float32)
    truth = np.where(coverage > 0, 2 * albedo, 30).astype(np.float32)
    means = lambda image: image.reshape(4, 4, 8, 4, 3).mean(axis=(1, 3))  # noqa: E731
    layers = divided(means(truth), means(albedo), coverage)
    found = multiplied(enlargement(layers, 16, 32, "bilinear"), albedo, coverage)
    np.testing.assert_allclose(found, truth, rtol=1e-3)
    assert np.abs(enlargement(means(truth), 16, 32) - truth)[:, :14].max() > 0.5


def test_pixels_that_show_both_are_mixed_by_their_coverage():
    """And where no pixel nearby shows albedo alone, radiance is enlarged as it is."""
    albedo, coverage = np.full((8, 16, 3), 0.5, np.float32), np.ones((8, 16, 1), np.float32)
    albedo[:, 8:], coverage[:, 8:] = 0, 0
    albedo[:, 8], coverage[:, 8] = 0.2, 0.4
    radiance = np.full((2, 4, 3), 1.0, np.float32)
    radiance[:, 2:] = 6
    small_albedo = np.full((2, 4, 3), 0.5, np.float32)
    small_albedo[:, 2:] = 0
    layers = divided(radiance, small_albedo, coverage)
    found = multiplied(enlargement(layers, 8, 16, "bilinear"), albedo, coverage)
    np.testing.assert_allclose(found[:, :8], 1, rtol=1e-3)
    # The light of 2 on 0.2, and of 6 in the other 0.6.
    np.testing.assert_allclose(found[:, 8], 0.4 + 0.6 * 6, rtol=1e-3)
    np.testing.assert_allclose(found[:, 9:], 6, rtol=1e-3)
    thin = np.full_like(coverage, 0.5)
    mixed = multiplied(enlargement(divided(radiance, small_albedo, thin), 8, 16, "bilinear"), albedo, thin)
    np.testing.assert_allclose(mixed, enlargement(radiance, 8, 16, "bilinear"), rtol=1e-3)


def test_first_hits_are_the_tracers_and_cover_what_has_albedo(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    found, coverage = first_hits(tracer, camera, 5)
    expected = tracer.auxiliary(camera, frame_positions(camera), 4, 5)
    for name in ("albedo", "normal", "position"):
        for one, other in zip(getattr(found, name), getattr(expected, name), strict=True):
            np.testing.assert_allclose(one.numpy(), other.numpy(), atol=1e-5)
    covered, albedo = coverage.numpy(), np.max([one.numpy() for one in found.albedo], axis=0)
    assert set(np.unique(covered)) <= {0, 0.25, 0.5, 0.75, 1}
    np.testing.assert_array_equal(covered > 0, albedo > 0.0025)
    assert 0 < (covered == 1).mean() < 1


@pytest.mark.parametrize(("demodulated", "edges"), [(True, False), (False, True), (True, True)])
def test_guided_frames_have_the_edges_that_enlarged_ones_blur(tracer, demodulated, edges):
    camera, gaze = tracer.scene.camera.resized(96, 96), Gaze()
    truth = FullTrace(tracer, 64, denoised=True).render(View(camera), gaze, 0).image
    blurred = Enlarged(tracer, 32, True, 1 / 16).render(View(camera), gaze, 1).image
    guided = Guided(tracer, 32, True, 1 / 16, demodulated, edges)
    made = guided.render(View(camera), gaze, 1)
    assert list(made.milliseconds) == ["trace", "denoise", "enlarge", "total"]
    assert made.image.shape == truth.shape
    assert made.image.min() >= 0
    assert ssim(made.image, truth) > ssim(blurred, truth) + 0.03


def test_a_guided_frame_of_full_size_is_nearly_the_full_frame(tracer):
    camera, gaze = tracer.scene.camera.resized(48, 32), Gaze()
    full = FullTrace(tracer, 4, denoised=True).render(View(camera), gaze, 3).image
    same = Guided(tracer, 4, True, 1.0, demodulated=True, edges=False).render(View(camera), gaze, 3).image
    assert np.abs(np.minimum(same, 1) - np.minimum(full, 1)).mean() < 0.01
