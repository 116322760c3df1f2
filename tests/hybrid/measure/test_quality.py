"""The metrics of an image by region: equal images are perfect, and every metric sees a defect where it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from compose.base.errors import UserError
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.measure import frame_quality as quality
from hybrid.measure.frame_quality import (
    METRICS,
    Viewer,
    acuity_weight,
    checked_pair,
    metric_rows,
    region_metrics,
)
from hybrid.measure.image_metrics import REGIONS, ImageRegion, plain_regions, psnr, regions, ssim
from hybrid.measure.perceptual_metrics import flip_map
from tests import small

SIZE = 96
GAZE = Gaze(0.4, 0.55)
VIEWER = Viewer(Display(SIZE, SIZE, 12.0), GAZE)
DENSITY = VIEWER.display.pixels_per_degree
FOVEATION = Foveation(GAZE, 30.0, 20.0)


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    """A picture with edges and texture."""
    noise = small.rng().normal(size=(SIZE, SIZE, 3))
    blocks = np.kron(small.rng().uniform(0.1, 0.9, (8, 8, 3)), np.ones((12, 12, 1)))
    picture = blocks * (1 + 0.15 * gaussian_filter(noise, (1, 1, 0)) / 0.28)
    return np.clip(picture, 0.01, 1).astype(np.float32)


def table(image: np.ndarray, reference: np.ndarray) -> dict[tuple[str, str], float]:
    rows = metric_rows(image, reference, regions(FOVEATION, reference), VIEWER)
    return {(str(row["region"]), str(row["metric"])): float(row["value"]) for row in rows}


@pytest.fixture(scope="module")
def perfect(scene) -> dict[tuple[str, str], float]:
    """The metrics of a frame that equals its reference."""
    return table(scene, scene)


@pytest.fixture(scope="module")
def of_noise(scene) -> dict[tuple[str, str], float]:
    """The metrics of a noisy frame."""
    return table(noisy(scene, 0.3), scene)


def noisy(scene: np.ndarray, size: float) -> np.ndarray:
    return scene * small.rng().uniform(1 - size, 1 + size, scene.shape).astype(np.float32)


def test_a_frame_against_itself_is_perfect(perfect):
    best = {"psnr": 120, "ssim": 1, "fssim": 1, "flip": 0, "hdr-flip": 0, "lpips": 0, "jod": 10}
    assert {region for region, _ in perfect} == set(REGIONS)
    assert {"psnr", "ssim", "fssim"} <= {metric for _, metric in perfect}
    for (region, metric), value in perfect.items():
        assert value == pytest.approx(best[metric], abs=1e-6), (region, metric)


def test_metrics_of_one_region_alone_are_there_alone(perfect):
    found = perfect
    assert {region for region, metric in found if metric == "fssim"} == {"whole"}
    assert {region for region, metric in found if metric == "hdr-flip"} <= {"foveal"}
    assert {region for region, metric in found if metric == "lpips"} <= {"whole", "foveal"}
    order = [metric for region, metric in found if region == "whole"]
    assert order == [metric for metric in METRICS if metric in order]


@pytest.mark.parametrize("defect", ["noise", "blur"])
def test_each_metric_tells_where_a_defect_is(scene, perfect, defect):
    """In the fovea, then in the periphery: one region suffers, the other stays perfect."""
    bad = noisy(scene, 0.5) if defect == "noise" else gaussian_filter(scene, (2, 2, 0))
    parts = regions(FOVEATION, scene)
    found = {name: table(parts[name].alone(bad, scene), scene) for name in ("foveal", "peripheral")}
    for metric, more_is_better in METRICS.items():
        sign = 1 if more_is_better else -1
        for place, other in (("foveal", "peripheral"), ("peripheral", "foveal")):
            if (place, metric) not in perfect:
                continue
            assert sign * found[place][place, metric] < sign * perfect[place, metric] - 1e-3
            if ("whole", metric) in perfect:
                assert sign * found[place]["whole", metric] < sign * perfect["whole", metric] - 1e-3
            assert found[other][place, metric] == pytest.approx(perfect[place, metric], abs=1e-6)


def test_less_of_a_defect_is_better_in_every_metric(scene, of_noise):
    better = table(noisy(scene, 0.1), scene)
    for key in of_noise:
        sign = 1 if METRICS[key[1]] else -1
        assert sign * of_noise[key] < sign * better[key], key


def test_psnr_of_a_region_is_that_of_its_pixels(scene, of_noise):
    bad = noisy(scene, 0.3)
    for name, region in regions(FOVEATION, scene).items():
        assert of_noise[name, "psnr"] == pytest.approx(psnr(bad[region.mask], scene[region.mask]))


@pytest.mark.parametrize(
    "gaze", [GAZE, Gaze(0.0, 1.0), Gaze(0.97, 0.5)], ids=["inside", "in a corner", "at an edge"]
)
def test_ssim_of_a_region_is_the_mean_of_the_whole_map_there(scene, gaze):
    """Without errors outside of the region, though the map is computed in its box only."""
    parts, bad = regions(Foveation(gaze, 30.0, 20.0), scene), noisy(scene, 0.3)
    for row in metric_rows(bad, scene, parts, Viewer(VIEWER.display, gaze), wanted=["ssim"]):
        part = parts[str(row["region"])]
        expected = ssim(part.alone(bad, scene), scene, part.mask.astype(np.float32))
        assert row["value"] == pytest.approx(expected, abs=1e-6), row["region"]


def test_a_region_without_a_pixel_inside_the_margin_has_no_ssim(scene):
    """SSIM is known from the sixth pixel on."""
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[:5] = True
    for last, expected in ((5, []), (6, ["ssim"])):
        mask[:last] = True
        part = {"foveal": ImageRegion.of("foveal", mask)}
        rows = metric_rows(noisy(scene, 0.3), scene, part, VIEWER, wanted=["ssim"])
        assert [row["metric"] for row in rows] == expected


def test_only_what_is_wanted_is_computed(scene, of_noise, monkeypatch):
    monkeypatch.setattr(quality, "jod", None)
    parts = regions(FOVEATION, scene)
    rows = metric_rows(noisy(scene, 0.3), scene, parts, VIEWER, wanted=("ssim", "psnr"))
    assert [(row["region"], row["metric"]) for row in rows] == [
        (n, m) for n in parts for m in ("ssim", "psnr")
    ]
    for row in rows:
        assert row["value"] == pytest.approx(of_noise[str(row["region"]), str(row["metric"])])


def test_flip_of_a_region_is_the_mean_of_its_map(scene, of_noise):
    """The map is computed around the region only, and given whole where it is known."""
    pytest.importorskip("flip_evaluator", reason="FLIP's evaluator is not installed")
    parts = regions(FOVEATION, scene)
    bad, found = noisy(scene, 0.3), of_noise
    whole = flip_map(bad, scene, DENSITY)
    assert found["whole", "flip"] == pytest.approx(float(whole.mean()), abs=1e-6)
    for name in ("foveal", "peripheral", "seam"):
        expected = flip_map(parts[name].alone(bad, scene), scene, DENSITY)[parts[name].mask].mean()
        assert found[name, "flip"] == pytest.approx(float(expected), abs=1e-5), name
    known = metric_rows(bad, scene, {"whole": parts["whole"]}, VIEWER, whole_flip=np.full_like(whole, 0.5))
    assert {row["metric"]: row["value"] for row in known}["flip"] == 0.5


def test_the_foveal_crop_keeps_the_gaze_where_it_is(scene, monkeypatch):
    seen = []

    def recorded(image, reference, display, gaze):
        seen.append((image.shape[:2], gaze.pixel(image.shape[1], image.shape[0])))
        return 5.0

    monkeypatch.setattr(quality, "jod", recorded)
    parts = plain_regions(FOVEATION, (SIZE, SIZE))
    found = {(row["region"], row["metric"]): row["value"] for row in metric_rows(scene, scene, parts, VIEWER)}
    assert all(found[region, "jod"] == 5 for region in parts)
    by_region = dict(zip(parts, seen, strict=True))
    # The gaze is at (38.4, 52.8), the radius of the disc 28.8: it begins at 9.6 and 24.
    assert by_region["whole"] == by_region["peripheral"] == ((96, 96), pytest.approx((38.4, 52.8)))
    box = parts["foveal"].box
    assert (box[1].start, box[0].start) == (10, 24)
    assert by_region["foveal"] == (parts["foveal"].mask[box].shape, pytest.approx((28.4, 28.8)))


def test_foveal_metrics_are_those_of_the_foveal_region(scene, of_noise):
    found = of_noise
    fovea = regions(FOVEATION, scene)["foveal"]
    alone = region_metrics(noisy(scene, 0.3), scene, fovea, VIEWER, ("jod", "flip"))
    assert set(alone) == {metric for region, metric in found if region == "foveal"} & {"jod", "flip"}
    for metric, value in alone.items():
        assert value == pytest.approx(found["foveal", metric])


def test_what_is_not_installed_is_left_out(scene, monkeypatch):
    for name in ("jod", "lpips"):
        monkeypatch.setattr(quality, name, lambda *_: None)
    for name in ("flip_map", "hdr_flip_map"):
        monkeypatch.setattr(quality, name, lambda *_: None)
    assert {metric for _, metric in table(scene, scene)} == {"psnr", "ssim", "fssim"}
    fovea = regions(FOVEATION, scene)["foveal"]
    assert region_metrics(scene, scene, fovea, VIEWER, ("jod", "flip")) == {}


def test_what_the_eye_resolves_weighs_most_at_the_gaze(scene):
    weight = acuity_weight(VIEWER, (SIZE, SIZE))
    x, y = GAZE.pixel(SIZE, SIZE)
    assert weight[int(y), int(x)] == weight.max() == pytest.approx(1, abs=0.05)
    assert weight[0, -1] < 0.5
    # Rows come first.
    assert acuity_weight(VIEWER, (8, 16)).shape == (8, 16)


def test_fssim_counts_a_defect_at_the_gaze_for_more(scene):
    """The same defect in two places that SSIM does not tell apart."""
    flat = np.full((SIZE, SIZE, 3), 0.3, dtype=np.float32)
    x, y = (int(at) for at in GAZE.pixel(SIZE, SIZE))
    near, far = flat.copy(), flat.copy()
    for picture, row, column in ((near, y, x), (far, 16, 80)):
        picture[row - 4 : row + 4, column - 4 : column + 4] = 0.5
    whole = plain_regions(FOVEATION, (SIZE, SIZE), ("whole",))
    at_gaze, away = (
        {row["metric"]: row["value"] for row in metric_rows(one, flat, whole, VIEWER)} for one in (near, far)
    )
    assert at_gaze["ssim"] == pytest.approx(away["ssim"], abs=1e-4)
    assert at_gaze["fssim"] < away["fssim"] - 0.01


def test_pictures_that_cannot_be_compared_are_named(scene):
    with pytest.raises(UserError, match="baseline is 96 x 95 pixels, its reference 96 x 96"):
        checked_pair(scene[1:], scene, "baseline")
    broken = scene.copy()
    broken[3, 4, 1] = np.inf
    with pytest.raises(UserError, match="baseline has 1 pixels that are not finite"):
        checked_pair(broken, scene, "baseline")
    with pytest.raises(UserError, match="the reference of baseline has 1 pixels"):
        checked_pair(scene, broken, "baseline")
    with pytest.raises(UserError, match="the frame has 1 pixels"):
        metric_rows(broken, scene, regions(FOVEATION, scene), VIEWER)
