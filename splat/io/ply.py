"""PLY files in the layout of 3D Gaussian splatting (Kerbl et al. 2023)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below, write_whole
from splat.model.gaussians import MAX_DEGREE, Gaussians, sh_count

# The frames that imported Gaussians were trained on are unknown. With this focal length they get no wider
# filter than the pixel's.
UNBOUND_FOCAL = 1e9
# Their 48 coefficients are addressed by 32 bits, with a sign.
_MOST_GAUSSIANS = 2**31 // 48
# Of a file: that many, with 100 further properties.
_MOST_BYTES = 1 << 36
_MOST_HEADER = 1 << 16
# Normals have no meaning for Gaussians.
_UNREAD = ("nx", "ny", "nz")


def _ply_properties(degree: int) -> list[str]:
    """Names of a Gaussian's properties, in the order of the file."""
    rest = 3 * (sh_count(degree) - 1)
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def save_ply(path: str | Path, gaussians: Gaussians) -> None:
    """Writes Gaussians in the layout of the INRIA implementation, binary little-endian.

    Raises:
        UserError: the file cannot be written.
    """
    n = len(gaussians)
    names = _ply_properties(gaussians.degree)
    sh = gaussians.all_turning().sh
    # All coefficients of red, then those of green, then those of blue.
    harmonics = sh[0], sh[1:].permute(1, 0, 2).reshape(-1, n)
    turns = torch.nn.functional.normalize(gaussians.rotations, dim=0)
    shape = gaussians.opacity_logits[None], gaussians.log_scales, turns
    columns = [gaussians.means, torch.zeros(3, n), *harmonics, *shape]
    table = torch.cat([c.detach().cpu() for c in columns]).T.contiguous().numpy().astype("<f4")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    content = "\n".join(header).encode() + table.tobytes()
    write_whole(Path(path), lambda part: part.write_bytes(content))


def load_ply(path: str | Path) -> Gaussians:
    """Reads Gaussians in the layout of the INRIA implementation.

    Raises:
        UserError: the file is missing, truncated, or not of that layout, or a number in it is not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"{path}: no such file")
    try:
        size = require_size_below(path, _MOST_BYTES)
        with path.open("rb") as file:
            header = file.read(_MOST_HEADER)
        count, names, start = _ply_header(path, header)
        if size - start < count * len(names) * 4:
            raise UserError(f"{path}: truncated, {count} Gaussians are announced")
        table = np.fromfile(path, "<f4", count * len(names), offset=start).reshape(count, len(names))
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({one_line(error)})") from error
    rest = sum(name.startswith("f_rest_") for name in names)
    column = {name: i for i, name in enumerate(names)}
    _check_finite(path, table, column)
    take = lambda *wanted: torch.tensor(table[:, [column[w] for w in wanted]].T.copy())  # noqa: E731
    constant = take(*(f"f_dc_{i}" for i in range(3)))[None]
    directional = take(*(f"f_rest_{i}" for i in range(rest))).reshape(3, -1, count).permute(1, 0, 2)
    scales, turns = (take(*(f"{part}_{i}" for i in range(n))) for part, n in (("scale", 3), ("rot", 4)))
    sh = torch.cat([constant, directional]).contiguous()
    return Gaussians(take("x", "y", "z"), scales, turns, take("opacity")[0], sh)


def _check_finite(path: Path, table: NDArray[np.float32], column: dict[str, int]) -> None:
    """Names the first Gaussian and property that is not a finite number, if there is one."""
    read = [name for name in column if name in _ply_properties(MAX_DEGREE) and name not in _UNREAD]
    wrong = np.argwhere(~np.isfinite(table[:, [column[name] for name in sorted(read)]]))
    if len(wrong):
        row, name = wrong[0][0], sorted(read)[wrong[0][1]]
        value = table[row, column[name]]
        raise UserError(f"{path}: Gaussian {row + 1}: {name} is {value}; must be a finite number")


def _ply_header(path: Path, content: bytes) -> tuple[int, list[str], int]:
    """Number of Gaussians in a file, the names of their properties, and where the header ends."""
    end = content.find(b"end_header\n")
    lines = content[: max(end, 0)].decode("ascii", "replace").split("\n")
    if end < 0 or lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise UserError(f"{path}: not a binary little-endian PLY file")
    after = lambda start: [line[len(start) :].strip() for line in lines if line.startswith(start)]  # noqa: E731
    counts, names = after("element vertex "), after("property float ")
    rest = sum(name.startswith("f_rest_") for name in names)
    degree = round((rest / 3 + 1) ** 0.5) - 1
    known = 0 <= degree <= MAX_DEGREE and set(_ply_properties(degree)) - {*_UNREAD} <= set(names)
    known = known and rest == 3 * (sh_count(degree) - 1)
    if len(counts) != 1 or not known or len(after("property ")) != len(names):
        raise UserError(f"{path}: not a 3D Gaussian splatting PLY (float properties x, f_dc_0, scale_0, ...)")
    if not re.fullmatch(r"0*[1-9][0-9]{0,17}", counts[0]):
        declared = counts[0] if len(counts[0]) <= 40 else f"{counts[0][:40]}..."
        raise UserError(f"{path}: element vertex {declared}: must be a number of Gaussians, 1 or more")
    count = int(counts[0])
    if count > _MOST_GAUSSIANS:
        raise UserError(f"{path}: {count:,} Gaussians; at most {_MOST_GAUSSIANS:,} can be addressed")
    return count, names, end + len(b"end_header\n")
