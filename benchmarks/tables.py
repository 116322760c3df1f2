"""Writes the tables of README.md and docs/measured from the JSON in docs/measured/data.

    python -m benchmarks.tables

A table stands between `<!-- figures NAME -->` and `<!-- end -->`; what is between them is replaced.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.hard_scenes import SCENES
from compose.eye.acuity import DEFAULT_ACUITY_MODEL

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "docs" / "measured" / "data"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs" / "measured").glob("*.md")))
_BLOCK = re.compile(r"(<!-- figures (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
# Ways to make the fovea, in the order of the tables.
_MODES = ("raw", "denoised", "fused")


def measured(name: str) -> dict[str, Any]:
    """What `benchmarks.measure` kept under that name: command, date, machine and result."""
    found: dict[str, Any] = json.loads((DATA / f"{name}.json").read_text())
    return found


def result(name: str) -> dict[str, Any]:
    """The result of a measurement: what its command writes with --json."""
    found: dict[str, Any] = measured(name)["result"]
    return found


def result_rows(name: str) -> list[dict[str, Any]]:
    """The result of a measurement whose command writes rows."""
    rows: list[dict[str, Any]] = measured(name)["result"]
    return rows


def filled(text: str) -> str:
    """A page with its tables written anew.

    Raises:
        KeyError: the page names a table that does not exist.
    """
    return _BLOCK.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}\n{found[3]}", text)


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows))


def _table(header: Sequence[str], rows: Iterable[Sequence[str]], *names: str, below: str = "") -> str:
    """A table after the commands that measured it, when and where, and what is said below it."""
    return "\n\n".join([_provenance(*names), markdown(header, rows), *([below] if below else [])])


def _provenance(*names: str) -> str:
    first = measured(names[0])
    machine = first["machine"]
    where = machine["gpu"] or f"{machine['cores']} cores of {machine['cpu']}"
    commands = ", ".join(f"`{measured(name)['command']}`" for name in names)
    return f"{commands}: {where}, {first['date']}."


def _range(between: list[float], form: str) -> str:
    return f"{between[0]:{form}} to {between[1]:{form}}"


def quickstart() -> str:
    """The main job: quality, registration and time."""
    found = result("quickstart")
    ours, splats = (
        f"{found[name]['psnr']:.2f} dB ({_range(found[f'{name}_range']['psnr'], '.2f')}), "
        f"SSIM {found[name]['ssim']:.3f}"
        for name in ("hybrid", "splats_alone")
    )
    seconds, ratios = found["seconds"], _range(found["ratio_range"], ".1f")
    times = " / ".join(f"{found[f'{name}_ms']['p50']:.0f}" for name in ("hybrid", "disc", "path_traced"))
    rows = [
        ["whole job", f"{seconds['total']:.0f} s, {seconds['prepare']:.0f} of them to prepare"],
        ["hybrid frame", ours],
        ["splats alone, same views", splats],
        ["registration error of the splats", f"{found['registration_px']:.3f} px"],
        ["hybrid frame / disc alone / full path tracing, denoised as well", f"{times} ms"],
        ["hybrid frame against full path tracing", f"{found['ratio']:.1f}x ({ratios})"],
    ]
    return _table(["", ""], rows, "quickstart")


def _prepared_scenes(*scenes: str) -> str:
    """Held-out quality of scenes, rooms or not, after each stage of a preparation."""
    names = [f"prepare-{scene}" for scene in scenes]
    rows = [
        [
            scene,
            f"{stage['seconds']:.0f} s",
            f"{stage['gaussians']:,}",
            f"{stage['psnr']:.1f} ({stage['least_psnr']:.1f})",
            f"{stage['ssim']:.3f}",
        ]
        for scene, name in zip(scenes, names, strict=True)
        for stage in result(name)["curve"]
    ]
    header = ["scene", "after", "Gaussians", "PSNR, dB (worst view)", "SSIM"]
    return _table(header, rows, *names)


def resolution(name: str = "resolution") -> str:
    """Hybrid frames against full path tracing by resolution, beside FPC's Table 4."""
    rows = [
        [
            f"{row['width']}x{row['height']}",
            f"{row['ms']['p50']:.0f}",
            f"{row['full_ms']['p50']:.0f}",
            f"{row['ratio']:.2f}",
            f"{row['paper']['ratio']:.2f}",
        ]
        for row in result(name)["rows"]
    ]
    return _table(["size", "hybrid, ms", "full, ms", "ratio", "FPC's ratio"], rows, name)


def radius() -> str:
    """Ratio of full path tracing to hybrid frames by radius and resolution, and where it reaches 1."""
    found = result("radius")
    sizes = [(row["width"], row["height"]) for row in found["break_even"]]
    cells: dict[float, list[str]] = {}
    for row in sorted(found["rows"], key=lambda row: sizes.index((row["width"], row["height"]))):
        cell = f"{row['ratio']:.2f} ({100 * row['covered']:.0f} %)"
        cells.setdefault(row["radius"], []).append(cell)
    rows = [[f"{radius:g}", *own] for radius, own in cells.items()]
    ends = [row["radius"] for row in found["break_even"]]
    rows.append(["as fast up to", *("over 90 %" if end is None else f"{end:.0f} %" for end in ends)])
    rows.append(["FPC, its own scene", *(f"{row['paper']:.0f} %" for row in found["break_even"])])
    header = ["radius, % of the height", *(f"{width}x{height}" for width, height in sizes)]
    return _table(header, rows, "radius")


def denoiser() -> str:
    """Foveal quality and time by the way the fovea is made."""
    found = result("denoiser")["rows"]
    metrics = [name for name in ("psnr", "ssim", "flip", "jod") if f"foveal {name}" in found[0]["quality"]]
    rows = [
        [
            str(row["spp"]),
            row["fovea"],
            f"{row['ms']['p50']:.0f}",
            *(f"{row['quality'][f'foveal {name}']:.{_DIGITS[name]}f}" for name in metrics),
        ]
        for row in found
    ]
    header = ["spp", "fovea", "ms", *(_METRICS[name] for name in metrics)]
    return _table(header, rows, "denoiser")


def paths() -> str:
    """Time and quality of the whole frame by where paths are traced, on each scene."""
    names = [path.stem for path in sorted(DATA.glob("paths-*.json"))]
    rows = []
    for name in names:
        found = [row for row in result(name)["rows"] if row["fovea"] == "fused"]
        for disc, cells in zip(found[::2], found[1::2], strict=True):
            both = [
                f"{row['ms']['p50']:.0f} ms, {row['quality']['whole psnr']:.2f} dB, "
                f"{row['quality']['whole jod']:.2f} JOD, {row['quality']['foveal jod']:.2f} in the disc"
                for row in (disc, cells)
            ]
            rows.append([name.removeprefix("paths-"), str(disc["spp"]), *both])
    header = ["scene", "spp", "paths in the disc", "paths where needed"]
    return _table(header, rows, *names)


_METRICS = {"psnr": "PSNR, dB", "ssim": "SSIM", "flip": "FLIP", "jod": "FovVideoVDP, JOD"}
# Decibels from which on pictures count as the same.
_EXACT = 119.0
_DIGITS = {"psnr": 2, "ssim": 3, "flip": 3, "jod": 2}


def evaluation() -> str:
    """Means over the views of each method, whole frame and fovea, and the verdicts in words."""
    from hybrid.evaluation.results import Results, verdicts

    found = Results(result("evaluation"))
    columns = [("whole", "ssim"), ("whole", "jod"), ("foveal", "psnr"), ("foveal", "flip"), ("foveal", "jod")]
    rows = []
    for key in found.keys:
        values = [(found.mean(key, *column), _DIGITS[column[1]]) for column in columns]
        time = found.times.get(key)
        cells = ["" if value is None else f"{value:.{digits}f}" for value, digits in values]
        rows.append([found.label(key), "" if time is None else f"{time:.0f}", *cells])
    header = ["method", "ms", *(f"{region} {_METRICS[metric]}" for region, metric in columns)]
    below = "\n".join(f"- {line}" for line in verdicts(found.found))
    return _table(header, rows, "evaluation", below=below)


def integrators() -> str:
    """Efficiency and bias of the cached integrator."""
    rows = []
    for name in ("integrator-room", "integrator-staircase2"):
        found = result(name)
        for bias in found["bias"]:
            one, four = (row for row in found["rows"] if row["integrator"] == bias["integrator"])
            rows.append(
                [
                    found["scene"],
                    bias["integrator"],
                    f"{one['squared_error']:.3g} / {four['squared_error']:.3g}",
                    f"{one['ms']['p50']:.0f} / {four['ms']['p50']:.0f}",
                    f"{one['efficiency']:.1f} / {four['efficiency']:.1f}",
                    f"{bias['mean']:+.1%}",
                    f"{bias['worst_block']:.1%}",
                    f"{bias['p95_block']:.1%}",
                ]
            )
    header = ["scene", "integrator", "squared error, 1 / 4 spp", "ms", "efficiency"]
    header += ["bias of the mean", "worst block", "95 % of blocks below"]
    return _table(header, rows, "integrator-room", "integrator-staircase2")


def periphery() -> str:
    """The time that each acuity model saves in the periphery, and what a viewer notices of it."""
    rows = [
        [
            f"{row['gaze'][0]:g}, {row['gaze'][1]:g}",
            row["acuity_model"],
            f"{row['periphery_ms']['p50']:.0f} of {row['full_ms']['p50']:.0f}",
            f"{row['moving_ms']['p50']:.0f} of {row['moving_full_ms']['p50']:.0f}",
            f"{row['nodes_drawn']:,}",
            "" if row["jod"] is None else f"{row['jod']:.2f}",
            f"{row['ssim']:.4f}",
        ]
        for row in result_rows("periphery")
    ]
    header = ["gaze", "acuity model", "ms, camera still", "ms, camera moving", "nodes", "JOD", "SSIM"]
    return _table(header, rows, "periphery")


def levels() -> str:
    """Continuous levels of detail against layers, at as many Gaussians."""
    found = result("levels")
    rows = [
        [
            row["method"],
            f"{row['nodes']:,}",
            f"{row['ms']:.0f}",
            f"{row['psnr']:.1f}",
            "" if row["jod"] is None else f"{row['jod']:.2f}",
        ]
        for row in found["rows"]
    ]
    before, after = (f"{found[name]:.1f}" for name in ("before_db", "after_db"))
    fit = f"`hybrid levels` took {found['fit_seconds']:.0f} s for {found['steps']:,} steps, which brought "
    fit += f"{before} to {after} dB in views and cuts that it was not fitted to yet."
    return _table(["drawn", "Gaussians", "ms", "PSNR, dB", "JOD"], rows, "levels", below=fit)


def frames(name: str = "frame") -> str:
    """Whole frames: wall clock, kernels, launches, bytes on the host."""
    found = result_rows(name)
    sizes = dict.fromkeys((row["width"], row["height"]) for row in found)
    rows = []
    for width, height in sizes:
        for mode in _MODES:
            pair = [
                row for row in found if (row["width"], row["height"], row["mode"]) == (width, height, mode)
            ]
            rows.append(
                [
                    f"{width}x{height}",
                    mode,
                    ", ".join(f"{row['wall_ms']['p50']:.1f} / {row['wall_ms']['p95']:.1f}" for row in pair),
                    ", ".join(f"{row['kernels_ms']:.1f}" for row in pair),
                    ", ".join(str(row["launches"]) for row in pair),
                    ", ".join(f"{row['host_bytes'] / 1e6:.1f}" for row in pair),
                ]
            )
    header = ["size", "fovea", "wall, ms, p50 / p95", "kernels, ms", "launches", "host, MB"]
    return _table(header, rows, name)


def acuity() -> str:
    """Cut-offs of the acuity models, and how far they are from people's."""
    found = result("acuity")
    rows = []
    for name, model in found["models"].items():
        cutoffs = (f"{found['cutoffs'][name][place]:.1f}" for place in range(5))
        means = (f"{mean:+.2f}" for mean in model["means"])
        rows.append([f"`{name}`", *cutoffs, *means, f"{model['rms']:.2f}"])
    header = ["acuity model", *(f"{10 * place} degrees" for place in range(5))]
    header += [*(f"error at {10 * place}" for place in range(3)), "rms"]
    rms = found["left_one_out"]["rms"]
    left_out = f"Each person against `resolution-limit` fitted to all others: {rms:.3f} octaves."
    return _table(header, rows, "acuity", below=left_out)


def studies() -> str:
    """How exactly studies show what they ask for, and how far their analysis can be trusted."""
    found = result("studies")
    timing = markdown(
        ["shown in", "frames of a clip", "trials", "median", "99 %", "frames dropped", "late"],
        [
            [
                row["canvas"],
                *(str(row[name]) for name in ("frames", "trials")),
                *(f"{row[name]:.2f}" for name in ("median", "p99")),
                *(str(row[name]) for name in ("dropped", "late")),
            ]
            for row in found["timing"]
        ],
    )
    coverage = markdown(
        ["answers", "studies", "differences in their 95 % interval", "of 100 studies", "none, called one"],
        [
            [
                name,
                f"{row['studies']:,}",
                f"{100 * row['inside']:.1f} %",
                f"{100 * row['least_of_100']:.1f} to {100 * row['most_of_100']:.1f}",
                f"{100 * row['false_differences']:.1f} %",
            ]
            for name, row in found["coverage"].items()
        ],
    )
    published = markdown(
        ["choices", "conditions", "r", "rms"],
        [
            [name, str(row["conditions"]), f"{row['r']:.4f}", f"{row['rms']:.3f}"]
            for name, row in found["published"].items()
        ],
    )
    return "\n\n".join([_provenance("studies"), timing, coverage, published])


def stored() -> str:
    """What formats of Gaussians keep of a forest's finest layer."""
    found = result("stored")
    rows = [
        [
            f"`.{row['format']}`",
            f"{row['bytes'] / 1e6:.2f}",
            f"{row['bytes'] / row['count']:.0f}",
            str(row["degree"]),
            *(f"{row[name]:.2g}" for name in ("position", "scale", "rotation", "opacity", "colour")),
            "exact" if row["psnr"] >= _EXACT else f"{row['psnr']:.1f}",
        ]
        for row in found["formats"]
    ]
    header = ["file", "MB", "bytes per Gaussian", "degree", "position, deviations", "scale, share"]
    header += ["rotation, degrees", "opacity, 256ths", "colour, 256ths", "picture, dB"]
    what = f"{found['gaussians']:,} Gaussians of degree {found['degree']}. "
    what += (
        f"As other viewers show them, against the forest's own pictures: {found['fitted_psnr']:.1f} dB; "
        f"{found['as_trained_psnr']:.1f} dB without the fit."
    )
    return _table(header, rows, "stored", below=what)


def colmap() -> str:
    """What a data set of COLMAP keeps of frames."""
    found = result("stored")["colmap"]
    rows = [
        ["files", f"{found['images']} images, {found['points']:,} points, {found['bytes'] / 1e6:.2f} MB"],
        ["poses, largest difference of a number", f"{found['pose']:.1g}"],
        ["focal lengths and principal points", "exact" if found["lens"] == 0 else f"{found['lens']:.1g} px"],
        ["pictures against radiance on the sRGB curve, 256ths", f"{found['picture_256ths']:.2f}"],
    ]
    return _table(["", ""], rows, "stored")


def raster() -> str:
    """The rasterizer and its gradient alone."""
    found = result("raster")
    rows = [
        [name, f"{found[f'{name}_ms']['p50']:.1f}", f"{found[f'{name}_ms']['p95']:.1f}"]
        for name in ("forward", "backward")
    ]
    return _table(["", "median, ms", "p95, ms"], rows, "raster")


def window() -> str:
    """Frame rate and latency of the window, in Qt and in a browser."""
    found = result("window")
    rows = [
        [
            {"qt": "Qt, in memory", "browser": "headless Chromium"}[shell],
            f"{runs[0]['width']}x{runs[0]['height']}",
            ", ".join(f"{run['fps']:.1f}" for run in runs),
            ", ".join(f"{run['latency_ms']['p50']:.0f} / {run['latency_ms']['p95']:.0f}" for run in runs),
        ]
        for shell, runs in found["runs"].items()
    ]
    header = ["window", "size", "FPS, median of each run", "mouse to screen, ms, p50 / p95 of each run"]
    return _table(header, rows, "window")


def late_warp() -> str:
    """What frames gain that are warped to where the viewer is."""
    rows = [
        [
            row["movement"],
            f"{row['width']}x{row['height']}",
            *(f"{row[name]:.1f}" for name in ("late", "warped", "ms")),
        ]
        for row in result("late-warp")["rows"]
    ]
    header = ["movement", "size", "late, dB", "warped, dB", "warp, ms"]
    return _table(header, rows, "late-warp")


def remote() -> str:
    """What masks cost and show over a slow network, and what hostile clients do to the server."""
    found = result("remote")
    network, walk, many = (found[name] for name in ("network", "walk", "many"))
    age, lost = walk["age_ms"], walk["jod_lost_against_finest"]
    alone, beside = (many[f"{name}_per_s"]["mean"] for name in ("alone", "beside_hostile"))
    slow = f"{network['mbit_per_s']:.0f} Mbit/s, {network['ms_each_way']:.0f} ms each way, "
    rows = [
        ["network", slow + f"{network['loss']:.0%} loss"],
        ["masks per second, frames", f"{walk['masks_per_s']:.0f}, {walk['frames']:,}"],
        ["Mbit/s of masks", f"{walk['mbit_per_s']:.2f}"],
        ["age of the mask in use, ms, p50 / p99", f"{age['p50']:.0f} / {age['p99']:.0f}"],
        ["frames with holes", str(walk["holes"])],
        ["JOD lost against local cuts, mean / most", f"{lost['mean']:.3f} / {lost['most']:.3f}"],
        ["clients, half of them hostile; seconds", f"{many['clients']}; {many['seconds']:.0f}"],
        [
            "masks per second of an honest one, of as many views: alone / beside the hostile",
            f"{alone:.2f} / {beside:.2f} of {many['asked_per_s']:.0f}",
        ],
        [
            "honest clients lost, clients let in without the token",
            f"{many['honest_lost']}, {many['admitted_without_token']}",
        ],
        [
            "server's memory, MiB: alone, most; growth per minute",
            f"{many['mib_alone']:.0f}, {many['mib_most']:.0f}; {many['mib_per_minute']:+.1f}",
        ],
    ]
    return _table(["", ""], rows, "remote")


def headlines() -> str:
    """README's figures, one line each."""
    return markdown(["what", "figure"], [list(line()) for line in _HEADLINES])


def _speed() -> tuple[str, str]:
    rows = result("resolution")["rows"]
    ratios = ", ".join(f"{row['ratio']:.1f}x at {row['width']}x{row['height']}" for row in rows)
    return "`room`, 1 spp, radius 20 %: hybrid against full path tracing, gaze and camera moving", ratios


def _break_even() -> tuple[str, str]:
    found = [
        f"{'over 90' if row['radius'] is None else format(row['radius'], '.0f')} % at "
        f"{row['width']}x{row['height']}"
        for row in result("radius")["break_even"]
    ]
    return "radius up to which a hybrid frame is as fast as full path tracing", ", ".join(found)


def _against_baselines() -> tuple[str, str]:
    from hybrid.evaluation.results import OURS_KEY, Results

    found = Results(result("evaluation"))
    texts = []
    for region, metric in (("whole", "ssim"), ("foveal", "flip"), ("foveal", "jod")):
        ours = found.mean(OURS_KEY, region, metric)
        others = {key: found.mean(key, region, metric) for key in found.affordable_baselines()}
        known = {key: value for key, value in others.items() if value is not None}
        if ours is None or not known:
            continue
        best = (min if metric == "flip" else max)(known, key=lambda key: known[key])
        form = f".{_DIGITS[metric]}f"
        texts.append(
            f"{region} {metric.upper()} {ours:{form}}, best baseline ({best.method}) {known[best]:{form}}"
        )
    what = "`room`, 512x512, means over the views: a fused frame against baselines at equal time"
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
    texts = [
        f"{found['fps']:.0f} frames per second, {found['latency_ms']:.0f} ms from mouse to screen"
        for found in (medians["qt"], medians["browser"])
    ]
    text = f"{texts[0]}; in a browser {texts[1]}"
    return "the window, `room`, 640x480, radius 15 %, 1 spp, mouse moving", text


def _prepared() -> tuple[str, str]:
    texts = []
    for name in ("prepare-room", "prepare-staircase2"):
        found = result(name)
        stages = ", ".join(f"{row['psnr']:.1f} dB in {row['seconds']:.0f} s" for row in found["curve"])
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
        gains = " / ".join(
            f"{row['efficiency']:.1f}x" for row in found["rows"] if row["integrator"] == "cached"
        )
        bias = next(row["mean"] for row in found["bias"] if row["integrator"] == "cached")
        texts.append(f"{found['scene']} {gains} at a bias of {bias:+.1%}")
    return "efficiency of the cached integrator against `path`, raw frames, 1 / 4 spp", "; ".join(texts)


def _registration() -> tuple[str, str]:
    figure = f"{result('quickstart')['registration_px']:.2f} px"
    return "registration of splats with the path-traced frame", figure


def _rasterizer() -> tuple[str, str]:
    found = result("raster")
    text = f"{found['forward_ms']['p50']:.0f} ms forward, {found['backward_ms']['p50']:.0f} ms backward"
    return f"rasterizing {found['gaussians']:,} Gaussians at {found['width']}x{found['height']}", text


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
    *(headlines, quickstart, resolution, radius, denoiser, paths, evaluation, integrators, periphery, levels),
    *(acuity, studies, frames, raster, window, late_warp, remote, stored, colmap),
)
TABLES: dict[str, Callable[[], str]] = {
    **{made.__name__: made for made in _MADE},
    "prepare": lambda: _prepared_scenes("room", "staircase2", "room-moving"),
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
