"""The evaluation of a scene: its references, its work, and what it writes."""

from __future__ import annotations

import json
import shutil
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import hybrid.evaluation.entries
import hybrid.evaluation.equal_cost
import hybrid.evaluation.evaluation
import hybrid.measure.frame_quality
from compose.base.errors import UserError
from compose.fovea.foveation import FoveaMode
from hybrid.evaluation import sweep_catalogue as catalogue
from hybrid.evaluation.ablations import ablations
from hybrid.evaluation.baselines import families
from hybrid.evaluation.evaluation import (
    Evaluation,
    mean_rows,
    preparation_rows,
    reference_samples,
    stored_reference,
)
from hybrid.evaluation.evaluation_settings import FOVEAL_REFERENCE, EvaluationSettings
from hybrid.evaluation.methods import Family
from hybrid.evaluation.results import OURS
from hybrid.evaluation.scoring import score
from hybrid.measure.image_metrics import REGIONS, regions
from hybrid.measure.reference import Reference
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.image_files import write_png
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from tests import small
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend")
SMALL = ["--size", 48, 48, "--views", 1, "--apart", 1, "--seeds", 2, "--reference-spp", 4, "--repeats", 3]
QUICK = ["--quick", "--views", 2, "--seeds", 1]


@contextmanager
def scorers_here():
    """`scorers` without their processes, which take seconds to start."""
    yield partial(map, score)


FEW = (
    *("full", "full, denoised", "full, path, denoised", "enlarged", "enlarged, denoised"),
    *("rmfr", "rmfr, tuned", "hybrid, without fusion"),
)


def _few(methods: dict[str, Family]) -> dict[str, Family]:
    return {name: family for name, family in methods.items() if name in FEW}


@pytest.fixture(scope="module")
def evaluated(made, tmp_path_factory):
    """A command line that evaluates a box, its cache folder kept from call to call."""
    folder = tmp_path_factory.mktemp("evaluated")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYBRID_HOME", str(folder / "home"))
        patch.setattr(hybrid.evaluation.equal_cost, "_F", (0.1, 0.4))
        patch.setattr(hybrid.evaluation.equal_cost, "_SPP", (1,))
        patch.setattr(hybrid.evaluation.equal_cost, "_TRIALS", 3)
        patch.setattr(hybrid.evaluation.equal_cost, "_ENDURED", {2: 0.3})
        patch.setattr(hybrid.evaluation.entries, "OTHER_SPP", (16,))
        patch.setattr(hybrid.evaluation.evaluation, "scorers", scorers_here)
        # Few of the methods: each has kernels of its own to compile.
        patch.setattr(hybrid.evaluation.evaluation, "families", lambda *of: _few(families(*of)))
        patch.setattr(hybrid.evaluation.evaluation, "ablations", lambda *of: _few(ablations(*of)))
        # The two metrics that take longest are as if they were not installed.
        patch.setattr(hybrid.measure.frame_quality, "jod", lambda *_: None)
        patch.setattr(hybrid.measure.frame_quality, "hdr_flip_map", lambda *_: None)

        def command(report: Path, *options: object) -> int:
            common = ["evaluate", "cornell", "--forest", made / "box.forest", "--report", report]
            return run(patch, *common, *SMALL, *options)

        assert command(folder / "first") == 0
        yield folder, command


def quality_of(folder: Path) -> list[dict]:
    return json.loads((folder / "evaluation.json").read_text())["quality"]


def test_all_rows_are_there(evaluated):
    folder, _ = evaluated
    found = json.loads((folder / "first" / "evaluation.json").read_text())
    methods = {row["method"] for row in found["quality"]}
    assert {
        OURS,
        "hybrid, raw",
        "hybrid, denoised",
        "splats alone",
        "full",
        "enlarged",
        "rmfr",
    } <= methods
    assert {"rmfr, tuned", "full, denoised", "enlarged, denoised", f"{OURS}, 16 spp"} <= methods
    for row in found["quality"]:
        assert set(row) == {"view", "seed", "method", "budget", "region", "metric", "value"}
        assert row["budget"] in ("fixed", "equal-rays", "equal-time")
        assert row["region"] in REGIONS
    assert {row["seed"] for row in found["quality"]} == {0, 1}
    views = {row["view"]: row["kind"] for row in found["views"]}
    assert views == {0: "near", 1: "beyond", 2: "wide"}
    assert {row["view"] for row in found["quality"]} == set(views)
    counts = {(row["method"], row["budget"]): row["repeats"] for row in found["time"]}
    assert counts[OURS, "fixed"] == 3 * len(views)
    for row in found["time"]:
        assert (row["width"], row["height"]) == (48, 48)
        # So few frames have no 95th percentile.
        assert list(row["ms"]) == ["p50"]
        assert row["ms"]["p50"] > 0
        assert row["passes"]
    rays = {(row["method"], row["budget"]): row["rays"] for row in found["methods"]}
    ours = rays[OURS, "fixed"]
    assert rays["rmfr, tuned", "equal-rays"] == pytest.approx(ours, rel=0.05)
    assert rays["enlarged", "equal-rays"] == pytest.approx(ours, rel=0.05)
    assert all(row["psnr"] > 10 for row in found["references"])
    assert {row["budget"] for row in found["verdicts"]} == {"fixed", "equal-rays", "equal-time"}
    assert {row["views"] for row in found["verdicts"]} == {"near", "beyond", "wide"}
    prepared = {row["method"]: row["seconds"] for row in found["preparation"]}
    assert prepared["full, path, denoised"] == 0 < prepared["full, denoised"]
    # Forests that `train` makes do not say how long that took.
    assert prepared[OURS] is None
    assert found["machine"]["cores"] >= 1


@pytest.fixture(scope="module")
def quick(evaluated):
    """The same, quickly: two views and fewer rows."""
    folder, command = evaluated
    assert command(folder / "quick", *QUICK) == 0
    return folder, lambda report, *options: command(report, *QUICK, *options)


def test_the_same_seed_gives_the_same_quality_whether_interrupted_or_not(quick):
    folder, command = quick
    # In the second view.
    stop_after = 30
    calls = []

    def interrupted(*arguments):
        calls.append(1)
        if len(calls) == stop_after:
            raise KeyboardInterrupt
        write_png(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hybrid.evaluation.entries, "write_png", interrupted)
        assert command(folder / "second") == 130
    assert not (folder / "second" / "evaluation.json").exists()
    assert command(folder / "second") == 0
    assert quality_of(folder / "second") == quality_of(folder / "quick")


def test_parts_are_the_same_evaluation_bit_by_bit(quick, capsys):
    """Rays at equal time are those that were found before, in the cache folder; two parts have no view."""
    folder, command = quick
    report = folder / "parts"
    for number in (4, 2, 3):
        assert command(report, "--part", f"{number}/4") == 0
    assert run_here("merge", report) == 2
    assert "part 1 of 4 is missing" in capsys.readouterr().err
    assert not (report / "evaluation.json").exists()
    assert command(report, "--part", "1/4") == 0
    assert run_here("merge", report) == 0
    assert "the hybrid frame" in capsys.readouterr().out
    found, whole = (json.loads((at / "evaluation.json").read_text()) for at in (report, folder / "quick"))
    for name in ("quality", "references", "methods", "views", "verdicts", "settings", "machine"):
        assert found[name] == whole[name], name
    shown = {file.name for file in report.glob("*.png")}
    assert shown == {file.name for file in (folder / "quick").glob("*.png")}
    assert (report / "index.html").stat().st_size > 10_000
    (report / "part-2-of-4" / "journal.json").unlink()
    assert run_here("merge", report) == 2
    assert "remove part-2-of-4 and run it again" in capsys.readouterr().err


def run_here(*words: object) -> int:
    with pytest.MonkeyPatch.context() as patch:
        return run(patch, *words)


def test_a_quick_evaluation_leaves_rows_out(quick):
    folder, _ = quick
    found = json.loads((folder / "quick" / "evaluation.json").read_text())
    assert {row["kind"] for row in found["views"]} == {"near"}
    assert {row["budget"] for row in found["quality"]} == {"fixed", "equal-time"}
    names = {row["method"] for row in found["methods"]}
    assert {name for name in names if name.startswith("hybrid")} == {
        f"hybrid, {mode.value}" for mode in FoveaMode
    }
    assert {"splats alone", "rmfr, tuned"} <= names


def test_another_evaluation_in_the_same_folder_is_refused(evaluated, capsys):
    folder, command = evaluated
    assert command(folder / "first", "--spp", 3) == 2
    assert "holds results for other inputs (settings)" in capsys.readouterr().err
    assert command(folder / "third", "--gaze", 1.5, 0.5) == 2
    assert "gaze 1.5 0.5: lies outside the frame" in capsys.readouterr().err
    assert command(folder / "third", "--fov-a", 0, "--fov-b", 0) == 2
    assert "there is no fovea to evaluate" in capsys.readouterr().err


def test_the_page_works_in_a_browser(evaluated, tmp_path):
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium")
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("needs chromium and chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for option in ("--headless", "--no-sandbox", "--disable-gpu", "--window-size=1200,2400"):
        options.add_argument(option)
    for option in ("background-networking", "component-update", "sync", "quic"):
        options.add_argument(f"--disable-{option}")
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        browser.get((evaluated[0] / "first" / "index.html").as_uri())
        _look(browser)
        assert not [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    finally:
        browser.quit()


def _look(browser) -> None:
    """Pictures are shown, the slider follows the pointer, other pictures can be chosen, columns sort."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.support.ui import Select, WebDriverWait

    wait = WebDriverWait(browser, 20)
    ask = browser.execute_script
    shown = "return [...document.querySelectorAll('.stage img')].map(i => i.naturalWidth)"
    wait.until(lambda _: ask(shown) == [48, 48])
    wait.until(lambda _: ask("return document.getElementById('difference').width") == 48)
    stage = browser.find_element("id", "stage")
    ActionChains(browser).move_to_element_with_offset(stage, -stage.size["width"] // 4, 0).perform()
    at = float(ask("return document.getElementById('stage').style.getPropertyValue('--at')").rstrip("%"))
    assert at == pytest.approx(25, abs=2)
    before = ask("return document.querySelector('.stage .left').src")
    Select(browser.find_element("id", "left")).select_by_visible_text("splats alone")
    wait.until(lambda _: ask("return document.querySelector('.stage .left').src") != before)
    assert len(browser.find_elements("css selector", "#verdicts li")) >= 1
    assert len(browser.find_elements("css selector", ".plots svg")) >= 1
    head = browser.find_elements("css selector", "table.sortable thead th")[2]
    cells = "return [...document.querySelectorAll('table.sortable')][0].tBodies[0].rows"
    for order in (1, -1):
        head.click()
        texts = ask(f"return [...({cells[7:]})].map(r => r.cells[2].textContent)")
        values = [float(text) for text in texts if text != "-"]
        assert values == sorted(values, reverse=order < 0)
        # What was not measured comes last.
        assert "-" not in texts[: len(values)]


def test_a_sweep_goes_into_the_page(evaluated, made, monkeypatch, capsys):
    folder, _ = evaluated
    monkeypatch.setattr(catalogue, "_RADII", (20, 90))
    monkeypatch.setattr(catalogue, "FPC_BREAK_EVEN", {(48, 32): 51.0})
    common = ["sweep", "cornell", "--forest", made / "box.forest", "--repeats", 3, "--warm-up", 1]
    assert run(monkeypatch, *common, "--over", "radius", "--report", folder / "nowhere") == 2
    assert "nowhere: holds no evaluation" in capsys.readouterr().err
    before = (folder / "first" / "index.html").read_text()
    assert run(monkeypatch, *common, "--over", "radius", "--report", folder / "first") == 0
    page = (folder / "first" / "index.html").read_text()
    assert "cornell, over radius of the fovea (FPC, Figures 7 to 10)" in page
    assert "48x32: as fast as full path tracing at a radius of" in page
    assert "<th>covered, %</th>" in page
    assert page.count("<svg") == before.count("<svg") + 1


def test_a_sweep_stays_off_the_page_of_another_scene_and_of_a_damaged_evaluation(
    evaluated, tmp_path, tmp_path_factory, monkeypatch, capsys
):
    """Refused before any work: there is no forest, and none is trained."""
    text = (evaluated[0] / "first" / "evaluation.json").read_text()
    monkeypatch.setenv("HYBRID_HOME", str(tmp_path_factory.mktemp("home")))
    damaged = (text[:-20], "[]", json.dumps({"scene": "cornell"}), "7")
    for content, said in [
        (text.replace('"scene": "cornell"', '"scene": "room"'), "an evaluation of room, not of")
    ] + [(content, "evaluation.json: is damaged") for content in damaged]:
        (tmp_path / "evaluation.json").write_text(content)
        assert run(monkeypatch, "sweep", "cornell", "--over", "radius", "--report", tmp_path) == 2
        error = capsys.readouterr().err
        assert said in error
        assert "training" not in error
        assert [file.name for file in tmp_path.iterdir()] == ["evaluation.json"]


def test_a_forest_of_another_scene_is_refused(made, tmp_path):
    room = load_scene(small.corner())
    with pytest.raises(UserError, match="belongs to scene cornell"):
        Evaluation(room, load_forest(made / "box.forest"), EvaluationSettings(), tmp_path)
    assert not list(tmp_path.iterdir())


SETTINGS = EvaluationSettings(FrameSettings((0.25, 0.5), 25, 25), width=64, height=40, reference_spp=3)


def made_up(height: int = 40, width: int = 64) -> Reference:
    rng = small.rng()
    halves = tuple(rng.uniform(0.2, 0.8, (height, width, 3)).astype(np.float32) for _ in range(2))
    errors = rng.uniform(1e-4, 2e-4, (height, width)).astype(np.float32)
    return Reference(0.5 * (halves[0] + halves[1]), halves, errors)


def test_the_disc_has_twice_the_samples():
    samples = reference_samples(SETTINGS).reshape(40, 64)
    assert set(samples.ravel()) == {3, 6}
    assert FOVEAL_REFERENCE == 2
    # A radius of 10 pixels around (16, 20).
    assert (samples == 6).sum() == pytest.approx(np.pi * 10**2, rel=0.03)
    assert samples[20, 7] == samples[11, 16] == 6
    assert samples[20, 27] == samples[32, 16] == 3


def test_a_reference_is_made_once_and_comes_back_as_it_was(tmp_path):
    file, made = tmp_path / "work" / "reference-0.exr", []
    file.parent.mkdir()

    def make() -> Reference:
        made.append(made_up())
        return made[-1]

    first, again = stored_reference(file, make), stored_reference(file, make)
    assert len(made) == 1
    for found in (first, again):
        np.testing.assert_array_equal(found.radiance, made[0].radiance)
        np.testing.assert_array_equal(found.errors, made[0].errors)
        for half, expected in zip(found.halves, made[0].halves, strict=True):
            np.testing.assert_array_equal(half, expected)


def test_errors_are_told_by_region():
    reference = made_up()
    reference.halves[1][...] = reference.halves[0]
    x, y = np.arange(64) + 0.5 - 16, np.arange(40) + 0.5 - 20
    reference.errors[...] = np.where(np.hypot(*np.meshgrid(x, y)) < 10, 1e-4, 1e-2)
    parts = regions(SETTINGS.frame.foveation, reference.radiance)
    psnr = {name: reference.psnr(part.mask) for name, part in parts.items()}
    assert psnr["foveal"] == pytest.approx(40)
    assert psnr["peripheral"] == pytest.approx(20)
    assert 20 < psnr["whole"] < 21
    assert "salient" in psnr


def test_methods_are_means_over_the_views():
    key = {"method": "full", "budget": "equal-time"}
    first = [{**key, "rays": 1.0, "spp": 2}, {**key, "method": "rmfr", "rays": 1.0, "denoised": "true"}]
    second = [{**key, "rays": 2.0, "spp": 2}]
    assert mean_rows([first, second]) == [
        {**key, "rays": 1.5, "spp": 2},
        {**key, "method": "rmfr", "rays": 1.0, "denoised": "true"},
    ]


def timed(method: str, milliseconds: float) -> dict:
    return {"method": method, "ms": {"p50": milliseconds}}


def test_preparation_pays_against_frames_that_need_none():
    """A forest of 90 s that saves 150 of 250 ms has paid after 600 frames, a cache of 3 s sooner."""
    times = [
        timed("hybrid, fused", 100.0),
        timed("splats alone", 300.0),
        timed("3dgs, no forest", 50.0),
        timed("full, denoised", 200.0),
        timed("full, path, denoised", 250.0),
        timed("full, path, early roulette, denoised", 240.0),
    ]
    seconds = {"forest": 90.0, "baseline forest": None, "cache": 3.0}
    found = preparation_rows(times, seconds, "cached")
    assert {row["method"]: (row["seconds"], row["frames_to_pay"]) for row in found} == {
        "hybrid, fused": (90.0, 600),
        "splats alone": (90.0, None),
        "3dgs, no forest": (None, None),
        "full, denoised": (3.0, 60),
        "full, path, denoised": (0.0, None),
        "full, path, early roulette, denoised": (0.0, 0),
    }
    assert preparation_rows([timed("full, denoised", 9.0)], seconds, "path")[0]["frames_to_pay"] is None
