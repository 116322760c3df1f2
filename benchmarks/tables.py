"""Writes the tables of README.md and docs/measured from the JSON in docs/measured/data.

    python -m benchmarks.tables

A table stands between `<!-- figures NAME -->` and `<!-- end -->`; what is between them is replaced.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

from benchmarks.hard_scenes import SCENES
from compose.eye.acuity import DEFAULT_ACUITY_MODEL
from hybrid.evaluation.sweep_catalogue import with_range

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "docs" / "measured" / "data"
PAGES = (ROOT / "README.md", ROOT / "docs" / "remote.md", *sorted((ROOT / "docs" / "measured").glob("*.md")))
_BLOCK = re.compile(r"(<!-- figures (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
# Ways to make the fovea, in the order of the tables.
_MODES = ("raw", "denoised", "fused")
_METRICS = {"psnr": "PSNR, dB", "ssim": "SSIM", "flip": "FLIP", "jod": "FovVideoVDP, JOD"}
_DIGITS = {"psnr": 2, "ssim": 3, "flip": 3, "jod": 2}
# Of an evaluation, by region and metric.
EVALUATED = ("whole ssim", "whole jod", "foveal psnr", "foveal flip", "foveal jod")
# Seconds that `room` is prepared in.
BUDGETS = (15, 30, 60, 180, 600)
# Decibels from which on pictures count as the same.
_EXACT = 119.0
Row = dict[str, Any]


def measured(name: str) -> Row:
    """What `benchmarks.measure` kept under that name: command, date, machine and result."""
    found: Row = json.loads((DATA / f"{name}.json").read_text())
    return found


def result(name: str) -> Row:
    """The result of a measurement: what its command writes with --json."""
    found: Row = measured(name)["result"]
    return found


def result_rows(name: str) -> list[Row]:
    """The result of a measurement whose command writes rows."""
    rows: list[Row] = measured(name)["result"]
    return rows


def filled(text: str) -> str:
    """A page with its tables written anew.

    Raises:
        KeyError: the page names a table that does not exist.
    """
    return _BLOCK.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}\n{found[3]}", text)


def markdown(header: str, rows: Iterable[str]) -> str:
    """A table in Markdown, of lines whose cells are separated by ` | `."""
    rule = " | ".join("---" for _ in header.split(" | "))
    return "\n".join(f"| {line} |" for line in (header, rule, *rows))


def _rows(form: str, rows: Iterable[Row]) -> list[str]:
    return [form.format_map(row) for row in rows]


def _table(header: str, rows: Iterable[str], *names: str, below: str = "") -> str:
    """A table after the commands that measured it, when and where, and what is said below it."""
    return "\n\n".join([_provenance(*names), markdown(header, rows), *([below] if below else [])])


def _provenance(*names: str) -> str:
    first = measured(names[0])
    machine = first["machine"]
    where = machine["gpu"] or f"{machine['cores']} cores of {machine['cpu']}"
    commands = ", ".join(f"`{measured(name)['command']}`" for name in names)
    return f"{commands}: {where}, {first['date']}."


def _known(value: float | None, form: str) -> str:
    """A value in a cell; empty if it was not measured."""
    return "" if value is None else format(value, form)


def quickstart() -> str:
    """The main job: quality, registration and time."""
    found = result("quickstart")
    quality = "{0[psnr]:.2f} dB ({1[psnr][0]:.2f} to {1[psnr][1]:.2f}), SSIM {0[ssim]:.3f}"
    ours, splats = (
        quality.format(found[name], found[f"{name}_range"]) for name in ("hybrid", "splats_alone")
    )
    rows = [
        "whole job | {seconds[total]:.0f} s, {seconds[prepare]:.0f} of them to prepare",
        f"hybrid frame | {ours}",
        f"splats alone, same views | {splats}",
        "registration error of the splats | {registration_px:.3f} px",
        "hybrid frame / disc alone / full path tracing, denoised as well | "
        "{hybrid_ms[p50]:.0f} / {disc_ms[p50]:.0f} / {path_traced_ms[p50]:.0f} ms",
        "hybrid frame against full path tracing | "
        "{ratio:.1f}x ({ratio_range[0]:.1f} to {ratio_range[1]:.1f})",
    ]
    return _table(" | ", [line.format_map(found) for line in rows], "quickstart")


def _prepared_scenes(*scenes: str) -> str:
    """Held-out quality of scenes, rooms or not, after each stage of a preparation."""
    form = "{seconds:.0f} s | {gaussians:,} | {psnr:.1f} ({least_psnr:.1f}) | {ssim:.3f}"
    names = [f"prepare-{scene}" for scene in scenes]
    rows = [
        line
        for scene, name in zip(scenes, names, strict=True)
        for line in _rows(f"{scene} | {form}", result(name)["curve"])
    ]
    return _table("scene | after | Gaussians | PSNR, dB (worst view) | SSIM", rows, *names)


def budgets() -> str:
    """Held-out quality of one scene by the time that it is prepared in."""
    form = "{used:.0f} s | {gaussians:,} | {psnr:.1f} ({least_psnr:.1f}) | {ssim:.3f}"
    names = [f"budget-{seconds}" for seconds in BUDGETS]
    rows = [
        f"{asked} s | " + form.format_map({**found["curve"][-1], "used": found["seconds"]})
        for asked, found in zip(BUDGETS, map(result, names), strict=True)
    ]
    return _table("asked | taken | Gaussians | PSNR, dB (worst view) | SSIM", rows, *names)


def resolution(name: str = "resolution") -> str:
    """Hybrid frames against full path tracing by resolution, beside FPC's Table 4."""
    form = "{width}x{height} | {ms[p50]:.0f} | {full_ms[p50]:.0f} | {ratio:.2f} | {paper[ratio]:.2f}"
    return _table(
        "size | hybrid, ms | full, ms | ratio | FPC's ratio", _rows(form, result(name)["rows"]), name
    )


def radius() -> str:
    """Ratio of full path tracing to hybrid frames by radius and resolution, and where it reaches 1."""
    found = result("radius")
    sizes = [f"{row['width']}x{row['height']}" for row in found["break_even"]]
    # Rows come size by size.
    lines: dict[float, list[str]] = {}
    for row in found["rows"]:
        cell = f"{row['ratio']:.2f} ({100 * row['covered']:.0f} %)"
        lines.setdefault(row["radius"], [f"{row['radius']:g}"]).append(cell)
    ends = [row["radius"] for row in found["break_even"]]
    reached = ["as fast up to", *("over 90 %" if end is None else f"{end:.0f} %" for end in ends)]
    papers = ["FPC, its own scene", *_rows("{paper:.0f} %", found["break_even"])]
    rows = [" | ".join(cells) for cells in (*lines.values(), reached, papers)]
    return _table(" | ".join(["radius, % of the height", *sizes]), rows, "radius")


def denoiser() -> str:
    """Foveal quality and time by the way the fovea is made."""
    found = result("denoiser")["rows"]
    metrics = [name for name in _METRICS if f"foveal {name}" in found[0]["quality"]]
    form = " | ".join(f"{{quality[foveal {name}]:.{_DIGITS[name]}f}}" for name in metrics)
    header = " | ".join(["spp | fovea | ms", *(_METRICS[name] for name in metrics)])
    return _table(header, _rows("{spp} | {fovea} | {ms[p50]:.0f} | " + form, found), "denoiser")


def paths() -> str:
    """Time and quality of the whole frame by where paths are traced, on each scene."""
    form = "{ms[p50]:.0f} ms, {quality[whole psnr]:.2f} dB, {quality[whole jod]:.2f} JOD, "
    form += "{quality[foveal jod]:.2f} in the disc"
    names = [path.stem for path in sorted(DATA.glob("paths-*.json"))]
    rows = []
    for name in names:
        found = [row for row in result(name)["rows"] if row["fovea"] == "fused"]
        # The disc comes before the cells.
        for spp, both in groupby(found, key=lambda row: row["spp"]):
            rows.append(" | ".join([name.removeprefix("paths-"), str(spp), *_rows(form, both)]))
    return _table("scene | spp | paths in the disc | paths where needed", rows, *names)


def evaluation() -> str:
    """Means over the views of each method, whole frame and fovea, and the verdicts in words."""
    rows, below = [], []
    for found in result_rows("evaluation"):
        for one in found["methods"]:
            cells = [_known(one["means"][name], f".{_DIGITS[name.split()[1]]}f") for name in EVALUATED]
            time = with_range(one["over_ours"], one["over_ours_range"], ".2f")
            rows.append(" | ".join([one["label"], f"{one['ms']['p50']:.0f}", time, *cells]))
        below += [f"- {line}" for line in found["sentences"]]
    header = " | ".join(["method | ms | / ours", *(_named(name) for name in EVALUATED)])
    return _table(header, rows, "evaluation", below="\n".join(below))


def preparation() -> str:
    """What methods need before their first frame."""
    rows = [
        f"{row['method']} | {_known(row['seconds'], '.0f')} | {_known(row['frames_to_pay'], ',')}"
        for found in result_rows("evaluation")
        for row in found["preparation"]
    ]
    return _table("method | s | frames to pay", rows, "evaluation")


def _named(column: str) -> str:
    region, metric = column.split()
    return f"{region} {_METRICS[metric]}"


def integrators() -> str:
    """Efficiency and bias of the cached integrator."""
    names = "integrator-room", "integrator-staircase2"
    columns = "{spp}", "{squared_error:.2g}", "{ms[p50]:.0f}", "{efficiency:.1f}"
    form, rows = "{mean:+.1%} | {worst_block:.1%} | {p95_block:.1%}", []
    for found in map(result, names):
        for bias in found["bias"]:
            by_spp = [row for row in found["rows"] if row["integrator"] == bias["integrator"]]
            cells = [" / ".join(_rows(column, by_spp)) for column in columns]
            rows.append(" | ".join([found["scene"], bias["integrator"], *cells, form.format(**bias)]))
    header = "scene | integrator | spp | squared error | ms | efficiency | "
    header += "bias of the mean | worst block | 95 % of blocks below"
    return _table(header, rows, *names)


def periphery() -> str:
    """The time that each acuity model saves in the periphery, and what a viewer notices of it."""
    form = (
        "{gaze[0]:g}, {gaze[1]:g} | {acuity_model} | {periphery_ms[p50]:.0f} of {full_ms[p50]:.0f} | "
        "{moving_ms[p50]:.0f} of {moving_full_ms[p50]:.0f} | {nodes_drawn:,} | {jod} | {ssim:.4f}"
    )
    found = [row | {"jod": _known(row["jod"], ".2f")} for row in result_rows("periphery")]
    header = "gaze | acuity model | ms, camera still | ms, camera moving | nodes | JOD | SSIM"
    return _table(header, _rows(form, found), "periphery")


_LEVELS = "room", "staircase2", "gantry", "workshop"


def levels() -> str:
    """Continuous levels of detail against others, at as many Gaussians."""
    form = (
        "{scene} | {display} | {gaussians} | {method} | {nodes:,.0f} | {psnr:.1f} | {jod:.2f} | "
        "{ahead[0]:.2f} ({ahead[1]:.2f} to {ahead[2]:.2f})"
    )
    rows, fits = [], []
    for name in _LEVELS:
        own = result(f"levels-{name}")["qualities"]
        rows += [row | {"scene": name} for row in own if row["method"] != "continuous"]
        fits.append({"scene": name, "seconds": measured(f"fit-{name}")["seconds"], **result(f"fit-{name}")})
    header = (
        "scene | display | Gaussians as | method | Gaussians | PSNR, dB | JOD | continuous levels ahead, JOD"
    )
    below = "; ".join(
        "{scene} {psnr_before:.1f} to {psnr:.1f} dB and {jod_error:.2f} JOD, in {seconds:.0f} s".format(**fit)
        for fit in fits
    )
    text = f"Fits of inner nodes, and mean error of learnt quality, in views that were left out: {below}."
    return _table(header, _rows(form, rows), *(f"levels-{name}" for name in _LEVELS), below=text)


def level_qualities() -> str:
    """Qualities that are asked for, and what is drawn for them."""
    rows = [row | {"scene": name} for name in _LEVELS for row in result(f"levels-{name}")["asked"]]
    form = "{scene} | {asked:.1f} | {jod:.2f} | {least:.2f} | {off:.2f} | {nodes:,.0f}"
    header = "scene | asked for, JOD | mean | least of the views | mean error | Gaussians"
    return _table(header, _rows(form, rows), *(f"levels-{name}" for name in _LEVELS))


def level_times() -> str:
    """Time of continuous levels of detail and of layers."""
    lines = _rows("{method} | {nodes:,} | {ms:.1f}", result("levels-room")["times"])
    return _table("drawn | Gaussians | ms", lines, "levels-room")


def frames(name: str = "frame") -> str:
    """Whole frames: wall clock, kernels, launches, bytes on the host."""
    forms = "{wall_ms[p50]:.1f} / {wall_ms[p95]:.1f}", "{kernels_ms:.1f}", "{launches}", "{megabytes:.1f}"
    found = [row | {"megabytes": row["host_bytes"] / 1e6} for row in result_rows(name)]
    rows = []
    for size in dict.fromkeys(f"{row['width']}x{row['height']}" for row in found):
        for mode in _MODES:
            pair = [r for r in found if (f"{r['width']}x{r['height']}", r["mode"]) == (size, mode)]
            rows.append(" | ".join([size, mode, *(", ".join(_rows(form, pair)) for form in forms)]))
    header = "size | fovea | wall, ms, p50 / p95 | kernels, ms | launches | host, MB"
    return _table(header, rows, name)


def acuity() -> str:
    """Cut-offs of the acuity models, and how far they are from people's."""
    found = result("acuity")
    rows = []
    for name, model in found["models"].items():
        cutoffs = (f"{cutoff:.1f}" for cutoff in found["cutoffs"][name][:5])
        means = (f"{mean:+.2f}" for mean in model["means"])
        rows.append(" | ".join([f"`{name}`", *cutoffs, *means, f"{model['rms']:.2f}"]))
    header = ["acuity model", *(f"{10 * place} degrees" for place in range(5))]
    header += [*(f"error at {10 * place}" for place in range(3)), "rms"]
    rms = found["left_one_out"]["rms"]
    left_out = f"Each person against `resolution-limit` fitted to all others: {rms:.3f} octaves."
    return _table(" | ".join(header), rows, "acuity", below=left_out)


def flicker() -> str:
    """How far the sensitivity to flicker is from that of people in each study."""
    rows = [
        f"{name} | {study['points']} | {study['factor']:+.2f} | {study['rms']:.2f} | "
        f"{_known(study['off_axis'], '+.2f')}"
        for name, study in result("flicker")["studies"].items()
    ]
    return _table("study | thresholds | factor | rms without it | off the fovea", rows, "flicker")


def gaze() -> str:
    """What somebody who looks around sees of each method."""
    form = (
        "{method} | {jod:.2f} | {low:.2f} to {high:.2f} | {foveal_jod:.2f} | {foveal_low:.2f} to "
        "{foveal_high:.2f} | {flicker:.2f} | {ms:.0f}"
    )
    header = "method | JOD | 95 % interval | JOD, fovea | 95 % interval | flicker | ms"
    return _table(header, _rows(form, result_rows("gaze")), "gaze")


def studies() -> str:
    """How exactly studies show what they ask for, and how far their analysis can be trusted."""
    found = result("studies")
    timing = markdown(
        "shown in | frames of a clip | trials | median | 99 % | frames dropped | late",
        _rows(
            "{canvas} | {frames} | {trials} | {median:.2f} | {p99:.2f} | {dropped} | {late}", found["timing"]
        ),
    )
    shares = "inside", "least_of_100", "most_of_100", "false_differences"
    coverage = [
        {"name": name, "studies": row["studies"]} | {share: 100 * row[share] for share in shares}
        for name, row in found["coverage"].items()
    ]
    form = "{name} | {studies:,} | {inside:.1f} % | {least_of_100:.1f} to {most_of_100:.1f} | "
    covered = markdown(
        "answers | studies | differences in their 95 % interval | of 100 studies | none, called one",
        _rows(form + "{false_differences:.1f} %", coverage),
    )
    published = [{"name": name, **row} for name, row in found["published"].items()]
    agreement = markdown(
        "choices | conditions | r | rms", _rows("{name} | {conditions} | {r:.4f} | {rms:.3f}", published)
    )
    return "\n\n".join([_provenance("studies"), timing, covered, agreement])


def stored() -> str:
    """What formats of Gaussians keep of a forest's finest layer."""
    found = result("stored")
    form = (
        "`.{format}` | {megabytes:.2f} | {each:.0f} | {degree} | {position:.2g} | {scale:.2g} | "
        "{rotation:.2g} | {opacity:.2g} | {colour:.2g} | {picture}"
    )
    rows = [
        form.format(
            **row,
            megabytes=row["bytes"] / 1e6,
            each=row["bytes"] / row["count"],
            picture="exact" if row["psnr"] >= _EXACT else f"{row['psnr']:.1f}",
        )
        for row in found["formats"]
    ]
    header = "file | MB | bytes per Gaussian | degree | position, deviations | scale, share | "
    header += "rotation, degrees | opacity, 256ths | colour, 256ths | picture, dB"
    what = (
        "{gaussians:,} Gaussians of degree {degree}. As other viewers show them, against the forest's own "
        "pictures: {fitted_psnr:.1f} dB; {as_trained_psnr:.1f} dB without the fit."
    )
    return _table(header, rows, "stored", below=what.format_map(found))


def colmap() -> str:
    """What a data set of COLMAP keeps of frames."""
    found = result("stored")["colmap"]
    rows = [
        f"files | {found['images']} images, {found['points']:,} points, {found['bytes'] / 1e6:.2f} MB",
        f"poses, largest difference of a number | {found['pose']:.1g}",
        "focal lengths and principal points | "
        + ("exact" if found["lens"] == 0 else f"{found['lens']:.1g} px"),
        f"pictures against radiance on the sRGB curve, 256ths | {found['picture_256ths']:.2f}",
    ]
    return _table(" | ", rows, "stored")


def raster() -> str:
    """The rasterizer and its gradient alone."""
    found = result("raster")
    rows = [
        f"{name} | {found[f'{name}_ms']['p50']:.1f} | {found[f'{name}_ms']['p95']:.1f}"
        for name in ("forward", "backward")
    ]
    return _table(" | median, ms | p95, ms", rows, "raster")


def window() -> str:
    """Frame rate and latency of the window, in Qt and in a browser."""
    forms = "{fps:.1f}", "{latency_ms[p50]:.0f} / {latency_ms[p95]:.0f}"
    rows = [
        " | ".join(
            [
                {"qt": "Qt, in memory", "browser": "headless Chromium"}[shell],
                f"{runs[0]['width']}x{runs[0]['height']}",
                *(", ".join(_rows(form, runs)) for form in forms),
            ]
        )
        for shell, runs in result("window")["runs"].items()
    ]
    header = "window | size | FPS, median of each run | mouse to screen, ms, p50 / p95 of each run"
    return _table(header, rows, "window")


def late_warp() -> str:
    """What frames gain that are warped to where the viewer is."""
    form = "{movement} | {width}x{height} | {late:.1f} | {warped:.1f} | {ms:.1f}"
    rows = _rows(form, result("late-warp")["rows"])
    return _table("movement | size | late, dB | warped, dB | warp, ms", rows, "late-warp")


def watching() -> str:
    """How soon a window shows a scene that nobody prepared, and what learning costs it."""
    found, form = result("watching"), "{} | {:.0f} | {:.0f} | {:.0f} | {:.0%}"
    rows = [
        form.format(scene, seconds, *(found["fps"][scene][name] for name in ("alone", "learning")), share)
        for scene, seconds in found["first_frame_s"].items()
        for share in [found["fps"][scene]["learning"] / found["fps"][scene]["alone"]]
    ]
    header = "scene | first frame after, s | frames a second alone | beside learning | rate kept"
    return _table(header, rows, "watching")


def relearning() -> str:
    """What a window learns of changes, and of places that it did not know."""
    found = result("watching")
    form = "{0} | {before:.1f} | {unlearnt:.1f} | {seconds:.0f} | {learnt:.1f}"
    changes = [form.format(name, **row) for name, row in found["changes"].items()]
    header = "change | before, dB | just after, dB | seconds to learn | learnt, dB"
    places = _rows("{seconds:.0f} | {place:.1f} | {home:.1f}", found["elsewhere"])
    seen = markdown("seconds at a new place | views there, dB | views where it came from, dB", places)
    return _table(header, changes, "watching", below=seen)


def long_window() -> str:
    """What hours leave of memory, rate and latency of the window in a browser."""
    found = result("long-window")
    names = {
        "window_mib": "memory of the window, MiB",
        "browser_mib": "memory of the browser, MiB",
        "frame_ms": "frame, ms",
        "latency_ms": "mouse to screen, ms",
    }
    rows = [f"frames in {found['hours']:.1f} hours | {found['frames']:,} | "]
    rows += ["{0} | {first:.0f} | {last:.0f}".format(name, **found[key]) for key, name in names.items()]
    return _table(" | median of the first quarter | of the last one", rows, "long-window")


def remote() -> str:
    """What masks and discs cost and show over a slow network, and what hostile clients do to the server."""
    form = """\
network | {network[mbit_per_s]:.0f} Mbit/s, {network[ms_each_way]:.0f} ms each way, {network[loss]:.0%} loss
masks per second, frames | {walk[masks_per_s]:.0f}, {walk[frames]:,}
Mbit/s of masks | {walk[mbit_per_s]:.2f}
age of the mask in use, ms, p50 / p99 | {walk[age_ms][p50]:.0f} / {walk[age_ms][p99]:.0f}
frames with holes | {walk[holes]}
JOD lost against local cuts, mean / most | {lost[mean]:.3f} / {lost[most]:.3f}
with discs: discs and masks per second | {discs[per_s]:.0f}, {streamed[masks_per_s]:.0f}
with discs: Mbit/s of discs and masks | {discs[mbit_per_s]:.2f} + {streamed[mbit_per_s]:.2f}
age of a disc when it comes, ms, p50 / p99 | {discs[age_ms][p50]:.0f} / {discs[age_ms][p99]:.0f}
from a jump of the gaze to the disc there, ms, p50 / p95 | {wait[p50]:.0f} / {wait[p95]:.0f}
fovea against many samples, dB: {lags} ms after a jump; rendered here | {fovea}
clients, half of them hostile; seconds | {many[clients]}; {many[seconds]:.0f}
masks per second of an honest one, of as many views: alone / beside the hostile | {rates} of {asked:.0f}
honest clients lost, clients let in without the token | {many[honest_lost]}, {many[admitted_without_token]}
server's memory, MiB: alone, most; growth per minute | {memory}; {many[mib_per_minute]:+.1f}"""
    found = result("remote")
    streamed = found["streamed"]
    errors = dict(streamed["fovea_db"])
    here = errors.pop("rendered here")
    more = {
        "discs": streamed["discs"],
        "wait": streamed["ms_until_the_disc"],
        "lags": ", ".join(errors),
        "fovea": "; ".join([", ".join(f"{value:.1f}" for value in errors.values()), f"{here:.1f}"]),
    }
    many, lost = found["many"], found["walk"]["jod_lost_against_finest"]
    rates = " / ".join(f"{many[f'{name}_per_s']['mean']:.2f}" for name in ("alone", "beside_hostile"))
    memory, asked = f"{many['mib_alone']:.0f}, {many['mib_most']:.0f}", many["asked_per_s"]
    text = form.format(**found, **more, lost=lost, rates=rates, memory=memory, asked=asked)
    return _table(" | ", text.splitlines(), "remote")


def headlines() -> str:
    """README's figures, one line each."""
    return markdown("what | figure", [" | ".join(line()) for line in _HEADLINES])


def _speed() -> tuple[str, str]:
    ratios = ", ".join(_rows("{ratio:.1f}x at {width}x{height}", result("resolution")["rows"]))
    return "`room`, 1 spp, radius 20 %: hybrid against full path tracing, gaze and camera moving", ratios


def _break_even() -> tuple[str, str]:
    found = [
        f"{_known(row['radius'], '.0f') or 'over 90'} % at {row['width']}x{row['height']}"
        for row in result("radius")["break_even"]
    ]
    return "radius up to which a hybrid frame is as fast as full path tracing", ", ".join(found)


def _against_baselines() -> tuple[str, str]:
    (found,) = result_rows("evaluation")
    texts = []
    for name in ("whole ssim", "foveal flip", "foveal jod"):
        known = {one["method"]: one["means"][name] for one in found["methods"] if one["affordable"]}
        known = {method: value for method, value in known.items() if not method.startswith("hybrid")}
        ours = next(one["means"][name] for one in found["methods"] if one["method"] == "hybrid, fused")
        best = (min if "flip" in name else max)(known, key=lambda method: known[method])
        region, metric = name.split()
        form = f".{_DIGITS[metric]}f"
        texts.append(f"{region} {metric.upper()} {ours:{form}}, best baseline ({best}) {known[best]:{form}}")
    settings = found["settings"]
    size = f"{settings['width']}x{settings['height']}"
    what = f"`room`, {size}, means over {found['views']} views: a fused frame against baselines at equal time"
    return what, "; ".join(texts)


def _fused() -> tuple[str, str]:
    rows = {(row["spp"], row["fovea"]): row["quality"]["foveal psnr"] for row in result("denoiser")["rows"]}
    gains = [
        f"{rows[spp, 'fused'] - rows[spp, 'denoised']:+.1f} dB at {spp} spp"
        for spp in dict.fromkeys(spp for spp, _ in rows)
    ]
    what = "the same, three unseen views: a fused fovea against a denoised one, over a draft forest"
    return what, ", ".join(gains)


def _window() -> tuple[str, str]:
    medians = result("window")["medians"]
    form = "{fps:.0f} frames per second, {latency_ms:.0f} ms from mouse to screen"
    qt, browser = _rows(form, (medians["qt"], medians["browser"]))
    return "the window, `room`, 640x480, radius 15 %, 1 spp, mouse moving", f"{qt}; in a browser {browser}"


def _prepared() -> tuple[str, str]:
    texts = []
    for name in ("prepare-room", "prepare-staircase2"):
        found = result(name)
        stages = ", ".join(_rows("{psnr:.1f} dB in {seconds:.0f} s", found["curve"]))
        texts.append(f"{found['scene']}: {stages}")
    return "from nothing to a forest, held-out views of 256x256", "; ".join(texts)


def _periphery() -> tuple[str, str]:
    row = next(row for row in result_rows("periphery") if row["acuity_model"] == DEFAULT_ACUITY_MODEL)
    quality = "" if row["jod"] is None else f" ({row['jod']:.2f} JOD)"
    full, ours = (f"{row[name]['p50']:.0f} ms" for name in ("full_ms", "periphery_ms"))
    text = f"{full} at full detail, {ours}{quality} with `{DEFAULT_ACUITY_MODEL}`"
    return f"periphery of `room`, {row['width']}x{row['height']} across 55 degrees, camera still", text


def _integrator() -> tuple[str, str]:
    texts = []
    for name in ("integrator-room", "integrator-staircase2"):
        found = result(name)
        rows, (bias,) = ([r for r in found[of] if r["integrator"] == "cached"] for of in ("rows", "bias"))
        gains = " / ".join(_rows("{efficiency:.1f}x", rows))
        spp = " / ".join(_rows("{spp}", rows))
        texts.append(f"{found['scene']} {gains} at {spp} spp, a bias of {bias['mean']:+.1%}")
    return "efficiency of the cached integrator against `path`, raw frames", "; ".join(texts)


def _registration() -> tuple[str, str]:
    figure = f"{result('quickstart')['registration_px']:.2f} px"
    return "registration of splats with the path-traced frame", figure


def _rasterizer() -> tuple[str, str]:
    what = "rasterizing {gaussians:,} Gaussians at {width}x{height}"
    times = "{forward_ms[p50]:.0f} ms forward, {backward_ms[p50]:.0f} ms backward"
    return what.format_map(found := result("raster")), times.format_map(found)


def _card() -> tuple[str, str]:
    found = measured("card-frame")
    rows = {(row["width"], row["mode"], row["live"]): row["wall_ms"]["p50"] for row in found["result"]}
    text = f"{rows[1920, 'fused', False]:.0f} ms, in the window {rows[1920, 'fused', True]:.0f} ms"
    card = f"{found['machine']['gpu']}, {found['date']}"
    return f"fused frame of `room`, 1920x1080, 1 spp, on a card ({card})", text


_HEADLINES: tuple[Callable[[], tuple[str, str]], ...] = (
    *(_speed, _break_even, _against_baselines, _fused, _window, _prepared),
    *(_periphery, _integrator, _registration, _rasterizer, _card),
)
_MADE = (
    headlines,
    quickstart,
    resolution,
    radius,
    denoiser,
    paths,
    evaluation,
    integrators,
    periphery,
    levels,
    level_qualities,
    level_times,
    preparation,
    acuity,
    flicker,
    gaze,
    studies,
    frames,
    raster,
    window,
    late_warp,
    watching,
    relearning,
    long_window,
    remote,
    stored,
    colmap,
)
TABLES: dict[str, Callable[[], str]] = {
    **{made.__name__: made for made in _MADE},
    "prepare": lambda: _prepared_scenes("room", "staircase2", "room-moving"),
    "budgets": budgets,
    "hard_scenes": lambda: _prepared_scenes(*SCENES),
    "card-frames": lambda: frames("card-frame"),
    "card-resolution": lambda: resolution("card-resolution"),
}


def main() -> None:
    """Writes all tables anew."""
    for page in PAGES:
        page.write_text(filled(page.read_text()))


if __name__ == "__main__":
    main()
