"""The quickstart's page: images side by side and the measurements, in one self-contained file."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

from compose.base.files import write_whole
from hybrid.evaluation.evaluation_page import rendered
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


def write_page(path: Path, folder: Path, result: dict[str, Any]) -> None:
    """Writes the page, which embeds the folder's four images; UserError if it cannot be written."""
    machine = result["machine"]
    page = rendered(
        "quickstart.html",
        title=f"Foveated hybrid frame of {result['scene']}",
        subtitle=f"{result['width']} × {result['height']}, {result['spp']} samples per pixel in the disc, "
        f"fov-a {result['fov_a']:g} %, fov-b {result['fov_b']:g} % of the height. Measured on "
        f"{machine['cpu']}, {machine['cores']} cores.",
        # fov-a and fov-b are circles that appear under the pointer.
        aspect=100 * result["width"] / result["height"],
        radii=(result["fov_a"], result["fov_b"]),
        figures=[
            {
                "title": title,
                "caption": caption.format(**result),
                "data": base64.b64encode((folder / f"{name}.png").read_bytes()).decode(),
            }
            for name, title, caption in _IMAGES
        ],
        rows=_rows(result),
        views=f"Measured in {result['views']} views near the scene's own to which nothing was fitted; the "
        "images show the first of them. Quality is the mean over the views and times are medians of all "
        "their frames; in brackets the least and the greatest value of a view.",
    )
    write_whole(path, lambda part: part.write_text(page, encoding="utf-8"))


def _rows(result: dict[str, Any]) -> list[tuple[str, str]]:
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
