"""More samples, fewer of them, or other pixels beside them never move the mean."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.base.compute_device import device_arrays
from hybrid.render.disc_tracer import DiscRequest, DiscTracer
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.compose.arrays_of import numbers
from tests.hybrid.forests import rough_forest
from tests.properties.chance import blocks, disagreement

RAW = FrameSettings(gaze=(0.45, 0.55), fov_a=60, fov_b=10, spp=1, fovea="raw", acuity_model="none")
# Of the runs that compare a mean; as many paths in each case.
RUNS = {1: 192, 4: 96, 16: 48, 64: 24}


@pytest.fixture(scope="module")
def matt(backend) -> Scene:
    """Without the mirror: the few paths that find the lamp in it make means far from normally distributed."""
    description = small.corner()
    description["ball"]["bsdf"] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    return load_scene(description)


@pytest.fixture(scope="module")
def matt_renderer(matt) -> Renderer:
    return Renderer(matt, rough_forest(matt))


@pytest.fixture(scope="module")
def truth(matt) -> NDArray[np.float32]:
    """(24, H, W, 3) frames of 512 samples per pixel."""
    return frames(Tracer(matt), 512, 24, 1_000_000)


def frames(tracer: Tracer, spp: int, count: int, seed: int) -> NDArray[np.float32]:
    """(count, H, W, 3) independent frames by `path`."""
    camera = tracer.scene.camera
    shape = camera.height, camera.width, 3
    traced = (tracer.trace(camera, frame_positions(camera), spp, seed + n).radiance for n in range(count))
    return np.array([interleaved(radiance).reshape(shape) for radiance in traced])


@pytest.mark.parametrize("spp", RUNS)
def test_the_number_of_samples_does_not_move_the_mean(matt, truth, spp):
    found = blocks(frames(Tracer(matt), spp, RUNS[spp], 1000 * spp))
    assert disagreement(found, blocks(truth)) < 1
    assert disagreement(1.01 * found, blocks(truth)) > 1


def test_a_thinned_band_blends_as_the_whole_one(matt_renderer, truth):
    """Of a raw fovea, at one sample per pixel: in the band most pixels have none."""
    found, parts = [], []
    for seed in range(1000, 1400):
        frame = matt_renderer.frame(RAW, seed)
        found.append(frame.composite)
        parts.append(frame.fovea.disc.count)
    weight = RAW.foveation.region(32, 32).weight_image()[..., None]
    expected = (1 - weight) * matt_renderer.splats(RAW) + weight * truth
    assert max(parts) < 0.7 * np.count_nonzero(weight)
    assert disagreement(blocks(np.array(found)), blocks(expected)) < 1
    # The test is able to see a band that is brighter by a tenth.
    assert disagreement(blocks(np.array(found)), blocks((1 + 0.1 * weight) * expected)) > 1


def test_a_raw_fovea_is_the_path_traced_frame_on_average(matt_renderer, truth):
    settings = replace(RAW, fov_a=35, fov_b=35, spp=4)
    inside = settings.foveation.region(32, 32).weight_image() == 1
    found = np.array([matt_renderer.frame(settings, 500 + seed).composite for seed in range(96)])
    one, other = (blocks(images * inside[..., None]) for images in (found, truth))
    assert disagreement(one, other) < 1


def adaptive(renderer: Renderer, spp: int) -> Callable[[int], NDArray[np.float32]]:
    """Renders the samples of a fused fovea over the whole frame, which go where they help most."""
    camera = renderer.scene.camera
    region = Foveation(Gaze(), 500, 500).region(camera.width, camera.height)
    underlay = renderer.underlay(camera, FrameSettings(fovea="fused"), region)
    disc, tracer = region.disc(device_arrays()), DiscTracer(renderer.tracer, history=False)

    def image(seed: int) -> NDArray[np.float32]:
        samples = tracer.trace(DiscRequest(camera, disc, spp, seed), underlay)
        return numbers(samples, "radiance").reshape(camera.height, camera.width, 3)

    return image


@pytest.mark.parametrize(("spp", "runs"), [(4, 150), (16, 60)])
def test_adaptive_samples_move_the_mean_by_less_than_half_a_percent(matt_renderer, truth, spp, runs):
    """They are not unbiased: how many samples a pixel gets depends on what its first ones showed.

    A pixel whose first samples are too bright gets more of them, which bring its mean down; one that is too
    dark gets none and stays so (Kirk and Arvo 1991). Only fused foveas are sampled like this, which are
    biased anyway. Seen over 600 runs: -0.14 % at 4 samples per pixel, -0.08 % at 8 and 16, nothing at 64.
    """
    image = adaptive(matt_renderer, spp)
    found = np.array([image(seed) for seed in range(runs)])
    assert abs(found.mean() / truth.mean() - 1) < 0.005
    one, other = (blocks(images).mean(axis=0) for images in (found, truth))
    assert np.abs(one / other - 1).max() < 0.12
