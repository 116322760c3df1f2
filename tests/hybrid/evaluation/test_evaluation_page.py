"""The page of an evaluation."""

from __future__ import annotations

import base64
import html
import io
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image as PillowImage

from compose.base.errors import UserError
from hybrid.evaluation.evaluation_page import (
    FORMS,
    embedded_flips,
    embedded_images,
    evaluated_scene,
    quality_table,
    time_table,
    write_report,
)
from hybrid.evaluation.quickstart import write_page
from hybrid.evaluation.results import BEYOND, OURS, Results, image_name
from hybrid.evaluation.sweep_catalogue import table
from hybrid.evaluation.verdicts import sentences
from hybrid.render.image_files import write_srgb
from tests import small
from tests.hybrid.evaluation import content
from tests.hybrid.evaluation.fakes import with_view


@pytest.fixture
def page(tmp_path) -> str:
    content.write(tmp_path)
    write_report(tmp_path)
    return (tmp_path / "index.html").read_text()


def test_verdicts_stand_at_the_top(page):
    listed = re.search(r'<ul id="verdicts">(.*?)</ul>', page, re.DOTALL).group(1)
    shown = [html.unescape(line) for line in re.findall("<li>(.*?)</li>", listed)]
    assert shown == sentences(content.evaluation())


def test_every_image_and_map_is_in_the_page(page):
    images, flips = (
        json.loads(part) for part in re.search("const images = (.*), flips = (.*);", page).groups()
    )
    labels = [key.label for key in Results(content.evaluation()).keys]
    assert [sorted(view) for view in images] == [sorted(["reference", *labels])] * 2
    assert [sorted(view) for view in flips] == [sorted(labels)] * 2
    urls = [url for view in images for url in view.values()]
    assert len(set(urls)) == len(urls)
    assert all(url.startswith("data:image/jpeg;base64,") for url in urls)


def test_tables_and_plots_are_there(page):
    headings = re.findall("<h[23]>(.*?)</h[23]>", page)
    for heading in ("Side by side", "Quality over time", "Quality", "whole", "foveal", "seam", "Time"):
        assert heading in headings
    # Foveal JOD, FLIP and whole SSIM over time, both over samples; and the one with the circles.
    assert page.count("<svg") == 3 + 2 + 1
    assert "<td>9.00</td>" in page
    # Quality of five regions, times, and preparation.
    assert page.count("<table") == 5 + 1 + 1


def test_preparation_has_what_it_takes_to_pay(page):
    rows = re.findall(
        "<tr><td>(.*?)</td><td>(.*?)</td>\n<td>(.*?)</td></tr>", page[page.index("Preparation") :]
    )
    assert rows == [(OURS, "61", "3060"), ("rmfr, tuned", "0", "0"), ("full", "-", "-")]


def test_views_apart_are_named_and_shown_but_not_in_the_means(tmp_path):
    """Of views whose images were not kept, only figures are there."""
    found = content.write(tmp_path)
    for _ in range(2):
        with_view(found, BEYOND, {"ssim": 0.1, "flip": 0.9, "jod": 1.0, "psnr": 10.0})
    (tmp_path / image_name(2, None)).write_bytes((tmp_path / image_name(0, None)).read_bytes())
    (tmp_path / "evaluation.json").write_text(json.dumps(found))
    before = Results(content.evaluation())
    for region in ("whole", "foveal"):
        assert quality_table(Results(found), region) == quality_table(before, region)
    write_report(tmp_path)
    page = (tmp_path / "index.html").read_text()
    assert re.findall('<option value="(.)">(.*?)</option>', page) == [
        ("0", "1, near"),
        ("1", "2, near"),
        ("2", "3, beyond"),
    ]
    assert "4 views, seeds per view: 1" in page
    assert "Means over 2 views near the scene" in page
    assert "2 views from beyond the prepared region: over the whole frame, by SSIM" in page


def test_settings_and_machine_are_named_and_escaped(page):
    assert "Evaluation of corner" in page
    assert "32 × 16, samples per pixel in the disc: 2, fov-a 20 %, fov-b 15 % of the height, 2 views" in page
    assert "References: 4 samples per pixel, 8 in the disc, denoised." in page
    assert "40.0 to 41.0 dB over the whole frame and 50.0 to 51.0 dB in the fovea" in page
    assert "An &lt;abacus&gt;, 2 cores, Python 3.11, numpy 1.26" in page


def test_references_that_no_denoiser_has_touched_are_not_called_denoised(tmp_path):
    found = content.write(tmp_path)
    found["settings"]["denoised_references"] = False
    (tmp_path / "evaluation.json").write_text(json.dumps(found))
    write_report(tmp_path)
    assert "4 samples per pixel, 8 in the disc." in (tmp_path / "index.html").read_text()


def test_circles_are_in_percent_of_the_height(page):
    """The frame is twice as wide as high, the gaze at a quarter of its width."""
    assert 'viewBox="0 0 200.0 100"' in page
    assert '<circle cx="50.0" cy="50.0" r="20.0"/><circle cx="50.0" cy="50.0" r="15.0"/>' in page


def test_a_sweep_is_added(tmp_path, page):
    (tmp_path / "sweep-radius.json").write_text(json.dumps(content.sweep()))
    write_report(tmp_path)
    more = (tmp_path / "index.html").read_text()
    assert more.count("<svg") == page.count("<svg") + 4
    assert "corner, over radius of the fovea, raw fovea, 3 frames each" in more
    assert "48x32: as fast as full path tracing at a radius of 50 % of the height (FPC: 51)" in more
    assert "<th>covered, %</th>" in more


def test_the_scene_of_an_evaluation_is_known(tmp_path):
    with pytest.raises(UserError, match="holds no evaluation"):
        evaluated_scene(tmp_path)
    found = content.write(tmp_path)
    assert evaluated_scene(tmp_path) == "corner"
    file = tmp_path / "evaluation.json"
    # Evaluations of earlier versions have no kinds of views.
    lacking = [
        {name: found[name] for name in found if name != gone} for gone in ("time", "views", "preparation")
    ]
    for damaged in (*map(json.dumps, lacking), "{", "7"):
        file.write_text(damaged)
        with pytest.raises(UserError, match=r"evaluation.json: is damaged"):
            evaluated_scene(tmp_path)


def test_a_baseline_that_missed_equal_time_is_nowhere_called_equal(tmp_path):
    """Neither in tables nor in plots, nor where images are chosen."""
    found = content.write(tmp_path)
    for row in found["time"]:
        if row["method"] == "rmfr, tuned":
            row["over_ours"] = 1.2
    (tmp_path / "evaluation.json").write_text(json.dumps(found))
    write_report(tmp_path)
    page = (tmp_path / "index.html").read_text()
    missed = "rmfr, tuned (equal-time, missed: 20 % slower)"
    images = json.loads(re.search("const images = (.*), flips = (.*);", page).group(1))
    assert all(missed in view for view in images)
    assert missed in page[page.index("Quality over time") : page.index("<script>")]
    assert "rmfr, tuned (equal-time)" not in page
    assert "<td>equal-time</td>" not in page


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
    write_page(folder, RESULT | changes)
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


def test_quality_has_a_row_per_method():
    found = content.evaluation()
    shown = quality_table(Results(found), "foveal")
    assert (shown["region"], shown["columns"]) == ("foveal", ["psnr", "flip", "jod"])
    cells = {(row["method"], row["budget"]): row["cells"] for row in shown["rows"]}
    assert cells["hybrid, fused", "fixed"] == ["30.00", "0.1000", "9.00"]
    assert cells["rmfr, tuned", "equal-time"] == ["30.00", "0.2000", "8.00"]
    assert list(cells) == Results(found).keys
    assert {row["method"] for row in shown["rows"] if row["ours"]} == {
        "hybrid, fused",
        "hybrid, fused, 16 spp",
    }


def test_times_have_percentiles_frame_rates_and_passes():
    found = content.evaluation()
    del found["time"][0]["ms"]["p95"]
    found["time"][1]["passes"]["denoise"] = 3.4
    shown = time_table(Results(found))
    assert shown["columns"] == ["p50", "p95", "p99", "/ ours", "FPS", "frames", "trace", "denoise"]
    assert shown["rows"][0]["cells"] == ["10", "-", "-", "1.00 (0.90–1.10)", "100.0", "20", "7", "-"]
    assert shown["rows"][1]["cells"] == ["40", "80", "-", "4.00 (3.60–4.40)", "25.0", "20", "28", "3"]


def test_a_sweeps_columns_end_with_its_quality():
    columns = table(content.sweep()["rows"], FORMS)
    assert list(columns)[-3:] == ["whole jod", "foveal jod", "foveal flip"]
    assert columns["whole jod"] == ["8.12", "8.12"]
    assert columns["foveal flip"] == ["0.1000", "0.1000"]
    assert columns["radius"] == ["20", "90"]


def test_a_baseline_that_missed_equal_time_is_marked_in_both_tables():
    found = content.evaluation()
    for row in found["time"]:
        if row["method"] == "rmfr, tuned":
            row |= {"over_ours": 1.2, "over_ours_range": [1.1, 1.4], "ms_range": [9.0, 13.0]}
    shown = time_table(Results(found))
    (row,) = (row for row in shown["rows"] if row["method"] == "rmfr, tuned")
    assert row["budget"] == "equal-time, missed: 20 % slower"
    assert (row["cells"][0], row["cells"][3]) == ("10 (9–13)", "1.20 (1.10–1.40)")
    budgets = [row["budget"] for row in quality_table(Results(found), "foveal")["rows"]]
    assert "equal-time, missed: 20 % slower" in budgets
    assert "equal-time" not in budgets


def test_a_sweeps_cells_have_the_range_over_the_views():
    rows = content.sweep()["rows"]
    for row in rows:
        row |= {"ms_range": [9.4, 120.6], "ratio_range": [0.3, 2.0]}
        row["quality_range"] = {"whole jod": [8.0, 8.25]}
    columns = table(rows, FORMS)
    assert columns["ms"] == ["30 (9–121)", "100 (9–121)"]
    assert columns["ratio"][0] == "1.33 (0.30–2.00)"
    assert columns["whole jod"] == ["8.12 (8.00–8.25)"] * 2
    assert columns["foveal jod"] == ["9.00"] * 2


def shown(url: str) -> np.ndarray:
    kind, data = url.split(",")
    assert kind == "data:image/jpeg;base64"
    return np.asarray(PillowImage.open(io.BytesIO(base64.b64decode(data))))


def test_each_label_shows_its_image_of_that_view(tmp_path):
    results = Results(content.write(tmp_path))
    keys = {key: results.label(key) for key in results.keys}
    for view in range(2):
        images = embedded_images(tmp_path, view, keys)
        assert list(images) == ["reference", *keys.values()]
        for number, url in enumerate(images.values()):
            assert shown(url).shape == (16, 32, 3)
            assert abs(shown(url).mean() - (20 * number + 10 * view)) < 2
        assert "rmfr, tuned (equal-time)" in images


def test_maps_that_do_not_exist_are_left_out(tmp_path):
    results = Results(content.write(tmp_path))
    keys = {key: results.label(key) for key in results.keys}
    assert abs(shown(embedded_flips(tmp_path, 0, keys)[OURS]).mean() - 20) < 2
    for file in tmp_path.glob("1-*-flip.png"):
        file.unlink()
    assert len(embedded_flips(tmp_path, 0, keys)) == len(keys)
    assert embedded_flips(tmp_path, 1, keys) == {}
