"""Path-traced baselines."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.base.compute_device import PassClock
from hybrid.evaluation.baselines import Tuning, WarpTuning, disc_over, families, warped
from hybrid.evaluation.baselines_guided import Guided
from hybrid.evaluation.baselines_traced import Enlarged, FullTrace, PathTraced, enlarged
from hybrid.evaluation.baselines_warped import Rmfr
from hybrid.evaluation.methods import Family
from hybrid.measure.image_metrics import psnr, registration_px
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from pathtrace.trace import Integrator
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.hybrid.evaluation.fakes import CAMERA
from tests.hybrid.forests import rough_forest

pytestmark = pytest.mark.usefixtures("backend")
WIDTH, HEIGHT = 48, 32


@pytest.fixture(scope="module")
def tracer(backend) -> Tracer:
    return Tracer(load_scene("cornell"))


def image(tracer: Tracer, spp: float, seed: int = 3, denoised: bool = False, clock: PassClock | None = None):
    camera = tracer.scene.camera.resized(WIDTH, HEIGHT)
    positions, clock = frame_positions(camera), clock or PassClock()
    return FullTrace(tracer, spp, denoised).traced(camera, positions, WIDTH, seed, clock)


def test_a_fraction_of_a_sample_goes_to_a_fraction_of_the_pixels(tracer, monkeypatch):
    asked, trace = [], tracer.trace

    def recorded(camera, positions, spp, seed):
        asked.append(spp)
        return trace(camera, positions, spp, seed)

    monkeypatch.setattr(tracer, "trace", recorded)
    one, same, other = (image(tracer, 2.25, seed) for seed in (3, 3, 4))
    image(tracer, 2.0)
    assert asked[0].mean() == pytest.approx(2.25)
    assert set(asked[0]) == {2, 3}
    # Scattered over the frame, not one part of it.
    assert 0.15 < (asked[0][: 24 * 32] == 3).mean() < 0.35
    assert asked[3] == 2
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    many, more = image(tracer, 128), image(tracer, 128.5)
    assert many.mean() == pytest.approx(more.mean(), rel=0.06)


def test_denoising_removes_noise_and_is_timed(tracer):
    truth = image(tracer, 256, seed=9)
    clocks = PassClock(), PassClock()
    raw, denoised = (image(tracer, 4, denoised=flag, clock=clocks[flag]) for flag in (False, True))
    assert raw.shape == denoised.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(denoised - truth).mean() < 0.85 * np.abs(raw - truth).mean()
    assert list(clocks[0].milliseconds()) == ["trace", "total"]
    assert list(clocks[1].milliseconds()) == ["trace", "denoise", "total"]


@pytest.mark.parametrize("spp", [1.5, 64])
def test_the_better_denoiser_is_used_at_any_sample_count(tracer, monkeypatch, spp):
    from pathtrace.trace.traced_images import TracedImage

    asked = []
    monkeypatch.setattr(
        TracedImage, "denoised", lambda self, quick=False: (asked.append(quick), self.radiance)[1]
    )
    image(tracer, spp, denoised=True)
    assert asked == [False]


TRACED_GAZE = Gaze(0.4, 0.55)


def test_an_enlarged_frame_of_full_size_is_the_full_frame(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    full = FullTrace(tracer, 2, denoised=False).render(View(camera), TRACED_GAZE, 3)
    same = Enlarged(tracer, 2, False, 1.0).render(View(camera), TRACED_GAZE, 3)
    np.testing.assert_allclose(same.image, full.image, rtol=1e-5, atol=1e-6)


def test_passes_are_named_and_add_up(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    for method, passes in (
        (FullTrace(tracer, 1, denoised=False), {"trace"}),
        (FullTrace(tracer, 1, denoised=True), {"trace", "denoise"}),
        (Enlarged(tracer, 1, False, 0.5), {"trace", "enlarge"}),
        (Rmfr(tracer, 1, True, 0.4, 1.5), {"trace", "denoise", "enlarge"}),
    ):
        milliseconds = method.render(View(camera), TRACED_GAZE, 0).milliseconds
        assert set(milliseconds) == {*passes, "total"}
        assert milliseconds["total"] == pytest.approx(sum(milliseconds[name] for name in passes))


@pytest.mark.parametrize("kind", ["enlarged", "rmfr"])
def test_baselines_line_up_and_converge_to_a_blurred_full_frame(tracer, kind):
    """With many samples nothing but their lower resolution is left."""
    camera = tracer.scene.camera.resized(96, 96)
    truth = FullTrace(tracer, 64, denoised=True).render(View(camera), TRACED_GAZE, 0).image
    if kind == "enlarged":
        image = Enlarged(tracer, 64, False, 0.25).render(View(camera), TRACED_GAZE, 1).image
    else:
        image = Rmfr(tracer, 64, False, 0.4, 1.5).render(View(camera), TRACED_GAZE, 1).image
    assert image.shape == truth.shape
    assert image.min() >= 0
    assert psnr(image, truth) > 20
    shift = registration_px(image, truth)
    assert shift is None or shift < 0.35
    if kind == "rmfr":
        # It is sharpest, and so best, at the gaze.
        near, far = np.s_[42:62, 28:48], np.s_[:20, -20:]
        error = np.abs(image - truth)
        assert error[near].mean() / truth[near].mean() < error[far].mean() / truth[far].mean()


def test_enlarging_is_bicubic_and_keeps_pixels_where_they_are(tracer, monkeypatch):
    """A ramp, traced with half of the resolution, comes back as the same ramp; overshoot is cut at 0."""

    def ramp(method, camera, positions, columns, *rest):
        rows = positions.count // columns
        across = (np.arange(columns) + 0.5) * camera.width / columns
        return np.broadcast_to(across[None, :, None], (rows, columns, 3)).astype(np.float32).copy()

    monkeypatch.setattr(PathTraced, "traced", ramp)
    camera = tracer.scene.camera.resized(48, 32)
    image = Enlarged(tracer, 1, False, 0.25).render(View(camera), TRACED_GAZE, 0).image
    assert image.shape == (32, 48, 3)
    expected = np.broadcast_to((np.arange(48) + 0.5)[None, :, None], (32, 48, 3))
    # A ramp comes back exactly only in the limit; an offset of half a pixel would be 0.5 or more.
    np.testing.assert_allclose(image[:, 4:-4], expected[:, 4:-4], atol=0.1)

    def edge(*arguments):
        image = ramp(*arguments)
        return np.where(image < 24, 0, 5).astype(np.float32)

    monkeypatch.setattr(PathTraced, "traced", edge)
    image = Enlarged(tracer, 1, False, 0.25).render(View(camera), TRACED_GAZE, 0).image
    assert image.min() == 0
    assert image.max() > 5.1


def test_rays_are_what_is_traced(tracer, monkeypatch):
    """Columns and rows of the traced image, times its samples, over the pixels of the frame."""
    camera = tracer.scene.camera.resized(90, 60)
    traced = []

    def counted(method, camera, positions, columns, *rest):
        traced.append(positions.count * method.spp / (camera.width * camera.height))
        return np.zeros((positions.count // columns, columns, 3), dtype=np.float32)

    monkeypatch.setattr(PathTraced, "traced", counted)
    for method, rays in (
        (FullTrace(tracer, 3, denoised=False), 3),
        (FullTrace(tracer, 1.25, denoised=True), 1.25),
        (Enlarged(tracer, 2, True, 0.25), 0.5),
        (Enlarged(tracer, 2, True, 1e-9), 2 / 5400),
        (Rmfr(tracer, 2, False, 0.1, 3.0), 2 / 9),
    ):
        assert method.rays(camera, TRACED_GAZE) == pytest.approx(rays)
        method.render(View(camera), TRACED_GAZE, 0)
        assert traced[-1] == pytest.approx(rays)


def test_settings_tell_methods_apart_in_tables(tracer):
    assert FullTrace(tracer, 2.5, denoised=True).settings == {"spp": 2.5}
    assert Enlarged(tracer, 4, True, 0.25).settings == {"spp": 4, "scale": 0.5}
    rmfr = Rmfr(tracer, 2, True, 0.4, 1.5).settings
    assert rmfr == {"spp": 2, "f": 0.4, "sigma": 1.5, "denoised": "true"}


def test_the_same_seed_gives_the_same_frame(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    method = Rmfr(tracer, 2, True, 0.1, 2.0)
    one, same, other = (method.render(View(camera), TRACED_GAZE, seed).image for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0


WIDE = CAMERA.resized(192, 128)
TUNING = Tuning(WarpTuning(0.4, 2, False), WarpTuning(0.1, 1, True), 2, 0.35)
SETTINGS = FrameSettings(fov_a=30, fov_b=20)
# Paths per pixel at the least: one sample of each pixel of a full frame, and of FPC's buffer.
LEAST = {
    "full": 1.0,
    "full, denoised": 1.0,
    "full, path, denoised": 1.0,
    "full, path, early roulette, denoised": 1.0,
    "rmfr": 1 / 2.6**2,
}


@pytest.fixture(scope="module")
def renderer(backend) -> Renderer:
    scene = load_scene(small.corner())
    return Renderer(scene, rough_forest(scene))


@pytest.fixture(scope="module")
def known(renderer) -> dict[str, Family]:
    return families(renderer, SETTINGS, TUNING)


def test_all_families_have_their_names(known):
    assert list(known) == [
        "full",
        "full, denoised",
        "full, path, denoised",
        "full, path, early roulette, denoised",
        "enlarged",
        "enlarged, denoised",
        "enlarged, light x albedo",
        "enlarged, edge-aware",
        "enlarged, light x albedo, edge-aware",
        "disc over enlarged",
        "rmfr",
        "rmfr, tuned",
        "rmfr, tuned for the fovea",
    ]


@pytest.mark.parametrize("rays", [0.2, 1.3, 2.01, 5.5])
def test_all_families_take_the_rays_that_they_are_given(known, rays):
    for name, family in known.items():
        method = family(rays)
        expected = max(rays, LEAST.get(name, 0.0))
        assert method.rays(WIDE, TRACED_GAZE) == pytest.approx(expected, rel=0.03), name
        # No smaller image has more pixels than the frame.
        assert getattr(method, "share", 1.0) <= 1 + 1e-9
        assert name == "rmfr" or getattr(method, "sigma", 1.0) >= 1 - 1e-9


def test_more_rays_are_never_fewer_pixels_or_samples(known):
    """So that time grows with rays."""
    for name, family in known.items():
        steps = [family(rays) for rays in np.geomspace(0.05, 6, 60)]
        samples = [method.spp for method in steps]
        shares = [getattr(method, "share", 1.0) for method in steps]
        sides = [-getattr(method, "sigma", 1.0) for method in steps]
        for values in (samples, shares, sides):
            assert (np.diff(values) > -1e-9).all(), name


def test_families_have_the_settings_that_their_names_promise(known):
    made = {name: family(0.4) for name, family in known.items()}
    raw = {name for name, method in made.items() if not method.denoised}
    assert raw == {"full", "enlarged", "rmfr", "rmfr, tuned"}
    # Foveated Path Culling's own setting.
    assert (made["rmfr"].f, made["rmfr"].sigma) == (0.1, 2.6)
    assert (made["rmfr, tuned"].f, made["rmfr, tuned"].spp) == (0.4, 2)
    assert (made["rmfr, tuned for the fovea"].f, made["rmfr, tuned for the fovea"].spp) == (0.1, 1)
    assert (made["enlarged"].spp, made["enlarged, denoised"].spp) == (1, 2)
    guided = [(m.demodulated, m.edges, m.spp) for m in made.values() if isinstance(m, Guided)]
    assert guided == [(True, False, 2), (False, True, 2), (True, True, 2)]
    disc = made["disc over enlarged"]
    assert (disc.foveation, disc.disc_share, disc.spp) == (SETTINGS.foveation, 0.35, 2)


def test_paths_are_those_of_hybrid_frames_unless_names_say_otherwise(renderer, known):
    tracers = {name: family(1.0).tracer for name, family in known.items()}
    early = tracers.pop("full, path, early roulette, denoised")
    assert tracers.pop("full, path, denoised") is renderer.tracer
    assert set(tracers.values()) == {renderer.tracer_of(Integrator.CACHED)}
    assert early not in (renderer.tracer, *tracers.values())
    unbiased = families(renderer, replace(SETTINGS, integrator=Integrator.PATH), TUNING)
    assert unbiased["full, denoised"](1.0).tracer is renderer.tracer
    assert unbiased["full, cached, denoised"](1.0).tracer is renderer.tracer_of(Integrator.CACHED)


def test_early_roulette_is_noisier_and_as_bright(renderer, known):
    camera = renderer.scene.camera.resized(32, 32)

    def traced(name: str, seed: int) -> np.ndarray:
        method = known[f"full, path{name}, denoised"](64.0)
        return method.with_features(camera, frame_positions(camera), 32, seed).radiance

    late, early = ([traced(name, seed) for seed in (1, 2)] for name in ("", ", early roulette"))
    assert np.mean(early) == pytest.approx(np.mean(late), rel=0.03)
    assert np.abs(early[0] - early[1]).mean() > 1.05 * np.abs(late[0] - late[1]).mean()


def test_settings_that_are_best_for_both_stand_once(renderer):
    same = replace(TUNING, fovea=TUNING.frame)
    assert "rmfr, tuned for the fovea" not in families(renderer, SETTINGS, same)


def test_few_rays_make_images_smaller_and_many_give_them_more_samples():
    """Half a ray per pixel at 2 samples: a quarter of the pixels; 2.5 rays: 2.5 samples of all."""
    small, large = (enlarged(None, 2, rays, denoised=False) for rays in (0.5, 2.5))
    assert (small.share, small.spp) == (0.25, 2)
    assert (large.share, large.spp) == (1.0, 2.5)
    small, large = (warped(None, TUNING.frame, rays) for rays in (0.5, 2.5))
    assert (small.sigma, small.spp) == (2.0, 2)
    assert (large.sigma, large.spp) == (1.0, 2.5)


def test_a_tuning_comes_back_from_json():
    assert Tuning.restored(json.loads(json.dumps(asdict(TUNING)))) == TUNING


@pytest.mark.parametrize("rays", [0.3, 3.0])
def test_a_disc_is_sharper_than_what_is_around_it(tracer, rays):
    camera = tracer.scene.camera.resized(96, 96)
    truth = FullTrace(tracer, 64, denoised=True).render(View(camera), TRACED_GAZE, 0).image
    disc = disc_over(tracer, Foveation(Gaze(), 25, 15), 1, 0.7, rays)
    region = disc._region(camera, TRACED_GAZE)
    image, around = (
        method.render(View(camera), TRACED_GAZE, 1).image for method in (disc, disc._around(region))
    )
    weight = region.weight_image()
    np.testing.assert_array_equal(image[weight == 0], around[weight == 0])
    inside = weight == 1
    assert np.abs(image - truth)[inside].mean() < 0.8 * np.abs(around - truth)[inside].mean()
    # The band is a mean of both, by the weight.
    band = (weight > 0.95) & (weight < 1)
    assert np.abs(image - truth)[band].mean() < np.abs(around - truth)[band].mean()


@pytest.mark.parametrize(("gaze", "radius"), [(TRACED_GAZE, 30), (Gaze(0, 0.5), 30), (Gaze(), 0)])
def test_a_disc_is_traced_in_the_disc_alone(tracer, monkeypatch, gaze, radius):
    """What `rays` says is what is traced, of which the disc has its share."""
    counts, trace = [], tracer.trace

    def counted(camera, positions, spp, seed, **features):
        counts.append(np.broadcast_to(spp, positions.count).sum() / (96 * 64))
        return trace(camera, positions, spp, seed, **features)

    monkeypatch.setattr(tracer, "trace", counted)
    camera = tracer.scene.camera.resized(96, 64)
    disc = disc_over(tracer, Foveation(Gaze(), radius, 0), 1, 0.4, 0.5)
    disc.render(View(camera), gaze, 0)
    assert sum(counts) == pytest.approx(disc.rays(camera, gaze), rel=0.01)
    assert counts == pytest.approx([0.3, 0.2] if radius else [0.5], rel=0.05)
