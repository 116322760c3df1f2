"""The quickstart's page: one file with images and measurements."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

import pytest

from compose.base.errors import UserError
from hybrid.evaluation.quickstart import write_page
from hybrid.render.image_files import write_srgb
from tests import small

RESULT = {
    "scene": "a <b> & c",
    "width": 512,
    "height": 256,
    "spp": 4,
    "fov_a": 20.0,
    "fov_b": 12.5,
    "seconds": {"capture": 61.2, "train": 120.6, "total": 200.4},
    "splat": {"psnr": 33.456, "ssim": 0.93234},
    "splats_alone": {"psnr": 30.456, "ssim": 0.91234},
    "views": 3,
    "hybrid": {"psnr": 35.004, "ssim": 0.95678},
    "hybrid_ms": {"p50": 101.6, "p95": 120.2},
    "path_traced_ms": {"p50": 512.4, "p95": 530.0},
    "disc_ms": {"p50": 80.0, "p95": 90.0},
    "ratio": 5.043,
    "ceiling": 6.421,
    "gaussians": 12345,
    "reference_spp": 64,
    "machine": {"cpu": "A & B CPU", "cores": 2},
}
NAMES = ("hybrid", "reference", "splat", "weights")


@pytest.fixture
def folder(tmp_path):
    """Four different images."""
    for number, name in enumerate(NAMES):
        image = small.rng(number).integers(0, 256, (4, 8, 3)).astype("uint8")
        write_srgb(tmp_path / f"{name}.png", image)
    return tmp_path


def page_of(folder, **changes: object) -> str:
    write_page(folder / "index.html", folder, RESULT | changes)
    return (folder / "index.html").read_text(encoding="utf-8")


def rows_of(page: str) -> dict[str, str]:
    return dict(re.findall(r"<th>(.*?)</th><td>(.*?)</td>", page))


def test_the_page_holds_every_image_and_needs_nothing_else(folder):
    page = page_of(folder)
    embedded = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert [base64.b64decode(data) for data in embedded] == [
        (folder / f"{name}.png").read_bytes() for name in NAMES
    ]
    assert "http" not in page
    assert "<script" not in page


def test_the_measurements_are_rounded_for_people(folder):
    assert rows_of(page_of(folder)) == {
        "Quality of the hybrid frame, against the reference": "35.00 dB, SSIM 0.9568",
        "Quality of the splats alone, against the reference": "30.46 dB, SSIM 0.9123",
        "The same in held-out views, at the resolution of training": "33.46 dB, SSIM 0.9323",
        "Time of the hybrid frame": "102 ms, p95 120 ms",
        "Time of a full path-traced frame, same samples, also denoised": "512 ms, p95 530 ms",
        "Time of the disc alone": "80 ms, p95 90 ms",
        "Speed-up over full path tracing": "5.04×; at most 6.42×, if splats took no time",
        "Gaussians": "12,345",
        "Duration": "capture 61 s, train 121 s, total 200 s",
    }


def test_an_offset_is_shown_where_it_could_be_measured(folder):
    rows = rows_of(page_of(folder, registration_px=0.07049))
    assert list(rows)[3] == "Offset between splats and path-traced frame"
    assert rows["Offset between splats and path-traced frame"] == "0.070 px"
    assert len(rows) == 10


def test_figures_of_several_views_have_their_range_and_the_page_says_of_what_they_are(folder):
    ranges = {"hybrid_range": {"psnr": (34.0, 36.0), "ssim": (0.95, 0.96)}, "hybrid_ms_range": (90.2, 110.7)}
    page = page_of(folder, **ranges, ratio_range=(4.5, 5.5))
    rows = rows_of(page)
    assert rows["Quality of the hybrid frame, against the reference"] == (
        "35.00 dB (34.00–36.00), SSIM 0.9568 (0.9500–0.9600)"
    )
    assert rows["Time of the hybrid frame"] == "102 ms (90–111), p95 120 ms"
    assert rows["Speed-up over full path tracing"].startswith("5.04× (4.50–5.50); at most")
    assert "Measured in 3 views near the scene&#39;s own to which nothing was fitted" in page


def test_the_page_says_what_was_rendered_and_where(folder):
    page = page_of(folder)
    assert "<title>Foveated hybrid frame of a &lt;b&gt; &amp; c</title>" in page
    assert "512 × 256, 4 samples per pixel in the disc, fov-a 20 %, fov-b 12.5 % of the height" in page
    assert "Measured on A &amp; B CPU, 2 cores." in page
    assert "path-traced, 64 samples per pixel, denoised" in page
    assert "12,345 Gaussians" in page


def test_the_radii_are_circles_in_percent_of_the_height(folder):
    page = page_of(folder)
    assert page.count('<svg viewBox="0 0 200.0 100">') == 4
    assert page.count('<circle cx="100.0" cy="50" r="20.0"/><circle cx="100.0" cy="50" r="12.5"/>') == 4


def test_every_element_is_closed(folder):
    class Checker(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.open: list[str] = []

        def handle_starttag(self, tag, attributes) -> None:
            if tag not in ("meta", "img"):
                self.open.append(tag)

        def handle_endtag(self, tag) -> None:
            assert self.open.pop() == tag

        def handle_startendtag(self, tag, attributes) -> None:
            assert tag == "circle"

    checker = Checker()
    checker.feed(page_of(folder, registration_px=0.1))
    assert checker.open == []


def test_a_page_that_cannot_be_written_is_named(folder):
    (folder / "index.html").mkdir()
    with pytest.raises(UserError, match=r"index\.html: cannot be written"):
        page_of(folder)
