"""The quickstart's page: pictures side by side with the numbers, one file that needs nothing else."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from string import Template
from typing import Any

from compose.base.files import write_whole

_PICTURES = (
    (
        "hybrid",
        "Hybrid",
        "path-traced inside the inner circle, splats outside the outer; point at a picture to see both",
    ),
    ("reference", "Reference", "path-traced, {reference_spp} samples per pixel, denoised"),
    ("splat", "Splats alone", "{gaussians:,} Gaussians"),
    (
        "weights",
        "What the fovea is made of",
        "red: path-traced samples, green: the same denoised, blue: splats",
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
<table><caption>What was measured</caption>$rows</table>
</body></html>
""")


def write_page(path: Path, folder: Path, result: dict[str, Any]) -> None:
    """Writes the page; the pictures are read from the folder and put into it."""
    figures = "".join(_figure(folder, result, *picture) for picture in _PICTURES)
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
    )
    write_whole(path, lambda part: part.write_text(page, encoding="utf-8"))


def _figure(folder: Path, result: dict[str, Any], name: str, title: str, caption: str) -> str:
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
    pair = lambda q: f"{q['psnr']:.2f} dB, SSIM {q['ssim']:.4f}"  # noqa: E731
    time = lambda t: f"{t['p50']:.0f} ms (p95 {t['p95']:.0f} ms)"  # noqa: E731
    seconds = ", ".join(f"{name} {value:.0f} s" for name, value in result["seconds"].items())
    rows = [
        ("Hybrid frame against the reference", pair(result["hybrid"])),
        ("Splats alone, views that training never saw", pair(result["splat"])),
        ("Hybrid frame", time(result["hybrid_ms"])),
        ("Full path-traced frame, same samples, denoised too", time(result["path_traced_ms"])),
        ("The disc alone", time(result["disc_ms"])),
        (
            "Hybrid is faster by",
            f"{result['ratio']:.2f}×  (ceiling, without splats: {result['ceiling']:.2f}×)",
        ),
        ("Gaussians", f"{result['gaussians']:,}"),
        ("Time taken", seconds),
    ]
    if "registration_px" in result:
        shift = f"{result['registration_px']:.3f} px"
        rows.insert(2, ("Registration of splats and path-traced frame", shift))
    return rows
