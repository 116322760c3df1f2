"""Cells that several benches print."""

from __future__ import annotations

from typing import Any


def metrics(row: dict[str, Any]) -> str:
    """PSNR, SSIM and, if installed, FLIP and JOD of a row."""
    flip = f"{row['flip']:.4f}" if "flip" in row else "     -"
    jod = f"{row['jod']:5.2f}" if "jod" in row else "    -"
    return f"{row['psnr']:6.2f}  {row['ssim']:.4f}  {flip}  {jod}"
