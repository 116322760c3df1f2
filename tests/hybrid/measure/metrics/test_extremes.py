"""Metrics at the ends: images that are equal, black, flat, tiny, huge, or not images at all."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS, Display
from compose.eye.gaze import Gaze
from hybrid.measure.image_metrics import SSIM_WINDOW, psnr, psnr_of_error, registration_px, ssim, valid_mean
from hybrid.measure.perceptual_metrics import flip_map, flip_reach, hdr_flip_map, jod, lpips
from tests import small
from tests.extremes import extreme

DESKTOP = DISPLAYS["desktop"]
DENSITY = DESKTOP.pixels_per_degree


def flat(value: float, *size: int) -> np.ndarray:
    return np.full((*(size or (32, 32)), 3), value, dtype=np.float32)


def seen(image: np.ndarray, reference: np.ndarray) -> float | None:
    return jod(image, reference, DESKTOP, Gaze())


def of_flip(image: np.ndarray, reference: np.ndarray) -> float | None:
    error = flip_map(image, reference, DENSITY)
    return None if error is None else float(error.mean())


METRICS = {
    "psnr": psnr,
    "ssim": ssim,
    "flip": of_flip,
    "hdr-flip": lambda image, reference: hdr_flip_map(image, reference, DENSITY),
    "jod": seen,
    "lpips": lpips,
    "registration": registration_px,
}


@pytest.fixture
def evaluator() -> None:
    pytest.importorskip("flip_evaluator", reason="FLIP's evaluator is not installed")


@pytest.fixture
def fovvideovdp() -> None:
    pytest.importorskip("pyfvvdp", reason="FovVideoVDP is not installed")


@extreme("PSNR of equal images", given="two equal images", expected="120 dB, a finite number")
def test_equal_images_have_120_db(got):
    assert got(psnr(flat(0.5), flat(0.5)), "g") == 120


@extreme("PSNR of black images", given="black against black, black against white", expected="120 and 0 dB")
def test_black_images_have_120_db_and_white_ones_none(got):
    assert got(psnr(flat(0), flat(0)), "g") == 120
    assert got(psnr(flat(1), flat(0)), ".0f") == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize(
    "metric",
    [
        pytest.param(
            name,
            marks=extreme(
                f"{name} of images that are not finite",
                given="one pixel of the image, or of the reference, is NaN or infinite",
                expected="refused, with the number of such pixels",
            ),
        )
        for name in METRICS
    ],
)
def test_images_that_are_not_finite_are_refused(metric, got):
    for value in (np.nan, np.inf):
        broken = flat(0.5, 64, 64)
        broken[3, 4, 1] = value
        for pair in ((broken, flat(0.5, 64, 64)), (flat(0.5, 64, 64), broken)):
            with pytest.raises(UserError, match="1 pixels that are not finite") as refused:
                METRICS[metric](*pair)
    got(str(refused.value))


@pytest.mark.parametrize("error", [np.nan, np.inf])
def test_an_error_that_is_no_number_has_no_psnr(error):
    with pytest.raises(UserError, match="must be finite"):
        psnr_of_error(error)


@extreme(
    "SSIM below its window",
    given="images of 10 x 64, 1 x 1 and 0 x 0 pixels",
    expected="refused, with the least size",
)
def test_images_smaller_than_its_window_have_no_ssim(got):
    assert ssim(flat(0.5, SSIM_WINDOW, SSIM_WINDOW), flat(0.5, SSIM_WINDOW, SSIM_WINDOW)) == 1
    for size in ((64, SSIM_WINDOW - 1), (1, 1)):
        with pytest.raises(UserError, match="must be at least 11 x 11") as refused:
            ssim(flat(0.5, *size), flat(0.4, *size))
    got(str(refused.value))
    with pytest.raises(UserError, match="has no pixels"):
        ssim(flat(0.5, 0, 0), flat(0.5, 0, 0))


def test_weights_at_the_border_alone_have_no_ssim():
    weight = np.zeros((32, 32), np.float32)
    weight[:5] = 1
    with pytest.raises(UserError, match="within 5 pixels of the border"):
        valid_mean(np.ones((32, 32), np.float32), weight)


@extreme(
    "FLIP of one pixel, and of huge values",
    given="1 x 1 pixel; radiance of 1e30 against 1e29; black against white",
    expected="finite, in 0..1",
)
@pytest.mark.usefixtures("evaluator")
def test_flip_is_finite_at_its_ends(got):
    for image, reference in (
        (flat(0.5, 1, 1), flat(0.2, 1, 1)),
        (flat(1e30), flat(1e29)),
        (flat(0), flat(1)),
    ):
        assert 0 <= got(of_flip(image, reference), ".3f") <= 1
    assert 0 <= float(hdr_flip_map(flat(1e30), flat(1e29), DENSITY).mean()) <= 1


@extreme(
    "HDR-FLIP against a black reference",
    given="references of 0, 1e-30 and 1e-8, for which the evaluator ends the process",
    expected="no value",
)
@pytest.mark.usefixtures("evaluator")
def test_a_black_reference_determines_no_exposure(got):
    for dark in (0.0, 1e-30, 1e-8):
        assert hdr_flip_map(flat(0.5), flat(dark), DENSITY) is None
    got("None")
    assert hdr_flip_map(flat(0.5), flat(2e-6), DENSITY) is not None


@extreme(
    "FLIP at 1 and at 150 pixels per degree",
    given="one pixel of 80 x 80 differs",
    expected="no influence beyond the reach that crops keep",
)
@pytest.mark.usefixtures("evaluator")
def test_no_pixel_has_an_influence_beyond_the_reach(got):
    for density in (1.0, 10.0, 32.2, 67.0, 150.0):
        reference = flat(0.5, 121, 121)
        image = reference.copy()
        image[60, 60] = 1
        rows, columns = np.nonzero(flip_map(image, reference, density))
        reached = max(np.abs(rows - 60).max(), np.abs(columns - 60).max())
        assert reached <= flip_reach(density)
    got(f"{reached} of {flip_reach(density)} px at {density:.0f}")


@extreme(
    "FLIP's pixels per degree",
    given="fine noise on displays of 67 and of 32 pixels per degree",
    expected="other values: FLIP sees it at the display's density",
)
@pytest.mark.usefixtures("evaluator")
def test_flip_is_that_of_the_display(got):
    from flip_evaluator import evaluate

    image = small.rng().uniform(0, 1, (48, 48, 3)).astype(np.float32)
    reference = flat(0.2, 48, 48)
    near, far = (flip_map(image, reference, density).mean() for density in (67.0, DENSITY))
    assert got(near, ".4f") != got(far, ".4f")
    from compose.image.colour import srgb_from_radiance

    shown = (srgb_from_radiance(one) for one in (reference, image))
    _, expected, _ = evaluate(*shown, "LDR", applyMagma=False, parameters={"ppd": DENSITY})
    assert far == pytest.approx(expected, rel=1e-5)


@extreme(
    "JOD of flat images",
    given="black in place of white, to which FovVideoVDP gives 10, and a flat image against itself",
    expected="no value, and 10",
)
@pytest.mark.usefixtures("fovvideovdp")
def test_flat_images_that_differ_have_no_jod(got):
    assert got(seen(flat(0), flat(1))) is None
    assert got(seen(flat(0.3), flat(0.3))) == 10


@extreme(
    "JOD of tiny and of huge images",
    given="1 x 1, 3 x 50 and 4 x 4 pixels; radiance of 1e30",
    expected="no value below 4 x 4 pixels, else finite",
)
@pytest.mark.usefixtures("fovvideovdp")
def test_tiny_images_have_no_jod(got):
    noise = small.rng().uniform(0, 1, (50, 50, 3)).astype(np.float32)
    for size in ((1, 1), (50, 3)):
        assert seen(noise[: size[0], : size[1]], flat(0.5, *size)) is None
    assert 0 < got(seen(noise[:4, :4], flat(0.5, 4, 4)), ".2f") < 10
    assert 0 < seen(noise * 1e30, noise) <= 10


@extreme(
    "JOD at 10,000 pixels per degree",
    given="a display of 10,000 pixels across 1 degree",
    expected="no value at once; constructing the metric would take hours",
)
@pytest.mark.usefixtures("fovvideovdp")
def test_a_display_denser_than_any_eye_has_no_jod(got):
    dense = Display(10_000, 1_000, 1.0)
    assert got(jod(flat(0.5), flat(0.4), dense, Gaze(0, 0))) is None


@extreme(
    "registration of flat images",
    given="flat against textured, textured against flat, flat against flat",
    expected="no value: a flat image would count as perfectly aligned",
)
def test_flat_images_have_no_registration(got):
    texture = np.kron(small.rng().uniform(0, 1, (16, 16, 3)), np.ones((8, 8, 1))).astype(np.float32)
    assert registration_px(texture, texture) == 0
    for pair in ((flat(0.5, 128, 128), texture), (texture, flat(0.5, 128, 128)), (flat(0), flat(0))):
        assert registration_px(*pair) is None
    got("None")
