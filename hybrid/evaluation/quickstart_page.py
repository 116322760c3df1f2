"""The quickstart's page: images side by side and the measurements, in one self-contained file."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from string import Template
from typing import Any

from compose.base.files import write_whole
from hybrid.evaluation.sweep_tables import with_range

# Name of the PNG file, title and caption.
_IMAGES = (
    (
        "hybrid",
        "Hybrid frame",
        "path-traced inside the inner circle, splats outside the outer one; hover to see the circles",
    ),
    ("reference", "Reference", "path-traced, {reference_spp} samples per pixel, denoised"),
    ("splat", "Splats alone", "{gaussians:,} Gaussians"),
    (
        "weights",
        "Weights of the fused fovea",
        "red: path-traced samples, green: the same samples denoised, blue: splats",
    ),
)

_PAGE = Template("""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>$title</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root { color-scheme: light dark }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 110rem; padding: 0 1.5rem }
h1 { font-size: 1.5rem; margin: 0 } p { margin: .3rem 0 1.2rem; opacity: .75 }
main { display: grid; gap: 1.2rem; grid-template-columns: repeat(auto-fit, minmax(18rem, 1fr)) }
figure { margin: 0 } .picture { position: relative; display: block }
img { width: 100%; display: block; border-radius: 4px }
svg { position: absolute; inset: 0; width: 100%; height: 100%; opacity: 0; transition: opacity .15s }
.picture:hover svg { opacity: 1 } circle { fill: none; stroke: #fff; stroke-width: .4; stroke-dasharray: 1.5 }
figcaption { margin-top: .4rem } figcaption small { display: block; opacity: .7 }
table { border-collapse: collapse; margin-top: 1.5rem } caption { text-align: left; font-weight: 600 }
th, td { padding: .25rem 1.2rem .25rem 0; text-align: left; font-weight: normal }
td { font-variant-numeric: tabular-nums; font-weight: 600 } tr + tr { border-top: 1px solid #8884 }
</style></head><body>
<h1>$title</h1><p>$subtitle</p>
<main>$figures</main>
<table><caption>Measurements</caption>$rows</table>
<p>$views</p>
</body></html>
""")


def write_page(path: Path, folder: Path, result: dict[str, Any]) -> None:
    """Writes the page.

    Args:
        path: HTML file to write.
        folder: with the images hybrid.png, reference.png, splat.png and weights.png, which are embedded.
        result: the content of result.json.

    Raises:
        UserError: the file cannot be written.
    """
    figures = "".join(_figure(folder, result, *image) for image in _IMAGES)
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in _rows(result)
    )
    machine = result["machine"]
    page = _PAGE.substitute(
        title=f"Foveated hybrid frame of {html.escape(result['scene'])}",
        subtitle=html.escape(
            f"{result['width']} × {result['height']}, {result['spp']} samples per pixel in the disc, "
            f"fov-a {result['fov_a']:g} %, fov-b {result['fov_b']:g} % of the height. Measured on "
            f"{machine['cpu']}, {machine['cores']} cores."
        ),
        figures=figures,
        rows=rows,
        views=html.escape(_views_note(result)),
    )
    write_whole(path, lambda part: part.write_text(page, encoding="utf-8"))


def _views_note(result: dict[str, Any]) -> str:
    """What the figures are of."""
    return (
        f"Measured in {result['views']} views near the scene's own to which nothing was fitted; the images "
        "show the first of them. Quality is the mean over the views and times are medians of all their "
        "frames; in brackets the least and the greatest value of a view."
    )


def _figure(folder: Path, result: dict[str, Any], name: str, title: str, caption: str) -> str:
    """HTML of one image, with fov-a and fov-b as circles that appear under the pointer."""
    data = base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
    aspect = 100 * result["width"] / result["height"]
    circles = "".join(
        f'<circle cx="{aspect / 2}" cy="50" r="{result[radius]}"/>' for radius in ("fov_a", "fov_b")
    )
    return (
        f'<figure><span class="picture"><img alt="{title}" src="data:image/png;base64,{data}">'
        f'<svg viewBox="0 0 {aspect} 100">{circles}</svg></span>'
        f"<figcaption>{title}<small>{caption.format(**result)}</small></figcaption></figure>"
    )


def _rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values of the measurements."""
    seconds = ", ".join(f"{name} {value:.0f} s" for name, value in result["seconds"].items())
    ceiling = f"at most {result['ceiling']:.2f}×, if splats took no time"
    speed_up = with_range(result["ratio"], result.get("ratio_range"), ".2f", "×")
    rows = [
        ("Quality of the hybrid frame, against the reference", _quality(result, "hybrid")),
        ("Quality of the splats alone, against the reference", _quality(result, "splats_alone")),
        ("The same in held-out views, at the resolution of training", _quality(result, "splat")),
        ("Time of the hybrid frame", _time(result, "hybrid_ms")),
        ("Time of a full path-traced frame, same samples, also denoised", _time(result, "path_traced_ms")),
        ("Time of the disc alone", _time(result, "disc_ms")),
        ("Speed-up over full path tracing", f"{speed_up}; {ceiling}"),
        ("Gaussians", f"{result['gaussians']:,}"),
        ("Duration", seconds),
    ]
    if "registration_px" in result:
        offset = with_range(result["registration_px"], result.get("registration_px_range"), ".3f", " px")
        rows.insert(3, ("Offset between splats and path-traced frame", offset))
    return rows


def _quality(result: dict[str, Any], name: str) -> str:
    """Mean over the views, and the range if there are several."""
    values, ranges = result[name], result.get(f"{name}_range", {})
    psnr = with_range(values["psnr"], ranges.get("psnr"), ".2f", " dB")
    return f"{psnr}, SSIM {with_range(values['ssim'], ranges.get('ssim'), '.4f')}"


def _time(result: dict[str, Any], name: str) -> str:
    """Median of all frames, the range of the views' medians, and p95."""
    median = with_range(result[name]["p50"], result.get(f"{name}_range"), ".0f", " ms")
    return f"{median}, p95 {result[name]['p95']:.0f} ms"
