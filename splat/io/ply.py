"""PLY files in the layout of 3D Gaussian splatting (Kerbl et al. 2023)."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from plyfile import PlyData, PlyParseError

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below, write_whole
from splat.model.gaussians import MAX_DEGREE, Blending, Gaussians, sh_count

# Focal length of unknown frames: imported Gaussians get no wider filter than the pixel's.
UNBOUND_FOCAL = 1e9
# Their 48 coefficients are addressed by 32 bits, with a sign.
_MOST_GAUSSIANS = 2**31 // 48
# Of a file: that many, with 100 further properties.
_MOST_BYTES = 1 << 36
_MOST_HEADER = 1 << 16
# Normals have no meaning for Gaussians.
_UNREAD = ("nx", "ny", "nz")
# A logit whose opacity is 1, and that of its negative 0, in float32.
_OPAQUE = 20.0
# The comment of files whose Gaussians are blended in linear radiance.
_LINEAR = "blending linear"
_LOG = logging.getLogger("hybrid")


def _ply_properties(degree: int) -> list[str]:
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

    A comment says so if linear radiance is blended: other programs, which blend by the rules of 3D Gaussian
    splatting, show such Gaussians otherwise.

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
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {_LINEAR}"] if gaussians.blending is Blending.LINEAR else []
    header += [f"element vertex {n}"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    content = "\n".join(header).encode() + table.tobytes()
    write_whole(Path(path), lambda part: part.write_bytes(content))


def load_ply(path: str | Path) -> Gaussians:
    """Reads Gaussians in the layout of the INRIA implementation.

    The file may be binary of either byte order or ASCII, and its numbers of any type. What else it has, such
    as further properties or elements, is left out, and logged. Infinite opacity logits count as finite ones
    of Gaussians that are opaque, or invisible. They are blended by the rules of 3D Gaussian splatting, unless
    a comment says that they are not.

    Raises:
        UserError: the file is missing, damaged, or not of that layout, or another number is not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"{path}: no such file")
    vertices, others, blending = _read(path)
    names = [name for name in vertices.dtype.names or () if vertices.dtype[name].kind in "fiu"]
    rest = sum(name.startswith("f_rest_") for name in names)
    degree = round((rest / 3 + 1) ** 0.5) - 1
    wanted = [name for name in _ply_properties(min(degree, MAX_DEGREE)) if name not in _UNREAD]
    if degree > MAX_DEGREE or rest != 3 * (sh_count(degree) - 1) or not set(wanted) <= set(names):
        raise UserError(f"{path}: not a 3D Gaussian splatting PLY (properties x, f_dc_0, scale_0, ...)")
    if not 0 < len(vertices) <= _MOST_GAUSSIANS:
        raise UserError(f"{path}: {len(vertices):,} Gaussians; must be 1 to {_MOST_GAUSSIANS:,}")
    left_out = [name for name in names if name not in (*wanted, *_UNREAD)] + others
    if left_out:
        _LOG.info(f"{path}: left out: {one_line(', '.join(left_out))}")
    with np.errstate(over="ignore"):
        columns = {name: vertices[name].astype(np.float32) for name in wanted}
    columns["opacity"] = np.nan_to_num(columns["opacity"], nan=np.nan, posinf=_OPAQUE, neginf=-_OPAQUE)
    wrong = {name: np.flatnonzero(~np.isfinite(values)) for name, values in columns.items()}
    if first := min(((rows[0], name) for name, rows in wrong.items() if len(rows)), default=None):
        row, name = first
        value = columns[name][row]
        raise UserError(f"{path}: Gaussian {row + 1}: {name} is {value}; must be a finite number")
    take = lambda *of: torch.from_numpy(np.stack([columns[name] for name in of]))  # noqa: E731
    constant = take(*(f"f_dc_{i}" for i in range(3)))[None]
    directional = [take(*(f"f_rest_{c * rest // 3 + k}" for c in range(3))) for k in range(rest // 3)]
    scales, turns = (take(*(f"{part}_{i}" for i in range(n))) for part, n in (("scale", 3), ("rot", 4)))
    sh = torch.cat([constant, torch.stack(directional)]) if rest else constant
    return Gaussians(take("x", "y", "z"), scales, turns, take("opacity")[0], sh, blending=blending)


def _read(path: Path) -> tuple[NDArray[Any], list[str], Blending]:
    """The rows of the element `vertex`, the names of the others, and the blending.

    UserError if the file is damaged.
    """
    try:
        size = require_size_below(path, _MOST_BYTES)
        with path.open("rb") as file:
            header, end, _ = file.read(_MOST_HEADER).partition(b"end_header")
        if not end or not header.startswith(b"ply"):
            raise ValueError("not a PLY file")
        # The library allocates what is announced.
        for line in re.findall(rb"^element .*?$", header, re.MULTILINE):
            count = line.split()[-1]
            if not re.fullmatch(rb"[0-9]{1,18}", count) or int(count) > size:
                raise ValueError(f"{line.decode(errors='replace')}: not a number of rows that it can hold")
        found = PlyData.read(path, mmap="r")
        if "vertex" not in found:
            raise ValueError("it has no element vertex")
        blending = Blending.LINEAR if _LINEAR in found.comments else Blending.DISPLAY
        others = [element.name for element in found if element.name != "vertex"]
        return found["vertex"].data, others, blending
    except (OSError, ValueError, OverflowError, MemoryError, PlyParseError) as error:
        raise UserError(f"{path}: cannot be read ({one_line(error)})") from error
