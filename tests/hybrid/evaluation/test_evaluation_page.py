"""The page of an evaluation has everything in one file."""

from __future__ import annotations

import html
import json
import re

import pytest

from compose.base.errors import UserError
from hybrid.evaluation.evaluation_page import evaluated_scene, write_report
from hybrid.evaluation.results import Results, verdicts
from tests.hybrid.evaluation import content


@pytest.fixture
def page(tmp_path) -> str:
    content.write(tmp_path)
    write_report(tmp_path)
    return (tmp_path / "index.html").read_text()


def test_verdicts_stand_at_the_top(page):
    listed = re.search(r'<ul id="verdicts">(.*?)</ul>', page, re.DOTALL).group(1)
    shown = [html.unescape(line) for line in re.findall("<li>(.*?)</li>", listed)]
    assert shown == verdicts(content.evaluation())


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
    assert page.count("<table") == 5 + 1


def test_settings_and_machine_are_named_and_escaped(page):
    assert "Evaluation of corner" in page
    assert "32 × 16, samples per pixel in the disc: 2, fov-a 20 %, fov-b 15 % of the height, 2 views" in page
    assert "References: 4 samples per pixel, 32 in the disc" in page
    assert "40.0 to 41.0 dB over the whole frame and 50.0 to 51.0 dB in the fovea" in page
    assert "An &lt;abacus&gt;, 2 cores, Python 3.11, numpy 1.26" in page


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
    del found["time"]
    for damaged in (json.dumps(found), "{", "7"):
        file.write_text(damaged)
        with pytest.raises(UserError, match=r"evaluation.json: is damaged"):
            evaluated_scene(tmp_path)


def test_a_baseline_that_missed_equal_time_is_nowhere_called_equal(tmp_path):
    """Neither in tables nor in plots, nor where images are chosen."""
    found = content.write(tmp_path)
    for row in found["time"]:
        row["over_ours"] = 1.2 if row["method"] == "rmfr, tuned" else row["ms"]["p50"] / 10
    (tmp_path / "evaluation.json").write_text(json.dumps(found))
    write_report(tmp_path)
    page = (tmp_path / "index.html").read_text()
    missed = "rmfr, tuned (equal-time, missed: 20 % slower)"
    images = json.loads(re.search("const images = (.*), flips = (.*);", page).group(1))
    assert all(missed in view for view in images)
    assert missed in page[page.index("Quality over time") : page.index("<script>")]
    assert "rmfr, tuned (equal-time)" not in page
    assert "<td>equal-time</td>" not in page
