"""Write the two scenes that move, ``room-moving`` and ``cloth``, next to this script.

``room-moving`` is ``room`` with a paper glider that crosses below the lamp, a brass ball that rolls over
the rug and a pinwheel that turns. ``cloth`` is a sheet on a line that swings over things on a floor. What
moves, and how, is in the motion file beside each scene:

    python scenes/write_moving_scenes.py
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from write_scenes import (
    CAMERA,
    HERE,
    TARGET,
    Builtin,
    Mesh,
    Point,
    box,
    bsdf,
    builtin_shapes,
    colour,
    grid,
    head,
    merge,
    metal,
    plastic,
    ply_shape,
    room_bsdfs,
    room_lights,
    room_shapes,
    sphere,
    write_shapes,
)

BALL_RADIUS, BALL_START, BALL_WAY = 0.12, (1.95, 2.72, 0.132), 2.4
PINWHEEL = (4.2, 2.45, 1.3)
SHEET_TOP, SHEET_HEIGHT, SHEET_WIDTH = 1.75, 1.15, 1.6


def glider() -> Mesh:
    """A paper glider that flies along +x, nose at the origin."""
    # Behind: wings with an inner edge, and a keel between them.
    behind = [
        (-0.34, y, z) for y, z in ((0.17, 0.03), (0.02, 0.03), (0, -0.06), (-0.02, 0.03), (-0.17, 0.03))
    ]
    triangles = [[(0, 0, 0), a, b] for a, b in itertools.pairwise(behind)]
    points = np.array(triangles, dtype=float).reshape(-1, 3)
    return Mesh(points, points[:, :2], np.arange(len(points)).reshape(-1, 3))


def pinwheel(at: Point) -> Mesh:
    """Four slanted blades around an axis along x."""
    blade = box([-0.006, 0.03, -0.05], [0.006, 0.3, 0.05]).turned(25, "y")
    blades = [blade.turned(90 * quarter, "x") for quarter in range(4)]
    return merge([*blades, sphere([0, 0, 0], 0.04, 16)]).moved(at)


def room_motion() -> dict[str, Any]:
    """The glider crosses below the lamp in a curve, the ball rolls there and back, the wheel turns twice."""
    rolled = float(np.degrees(BALL_WAY / BALL_RADIUS))
    flight = [(0.0, (2.35, 2.75, 1.62)), (0.5, (3.35, 2.08, 1.5)), (1.0, (4.3, 1.35, 1.6))]
    return {
        "seconds": 4,
        "shapes": {
            "glider_shape": {
                "keyframes": [{"t": t, "degrees": -34, "translate": list(at)} for t, at in flight],
            },
            "ball_shape": {
                "axis": [0, 1, 0],
                "about": list(BALL_START),
                "keyframes": [
                    {"t": 0},
                    {"t": 0.5, "degrees": rolled, "translate": [BALL_WAY, 0, 0]},
                    {"t": 1},
                ],
            },
            "pinwheel_shape": {
                "axis": [1, 0, 0],
                "about": list(PINWHEEL),
                "keyframes": [{"t": 0}, {"t": 1, "degrees": 720}],
            },
        },
    }


def write_room_moving(folder: Path) -> int:
    """Write the room, with the files of ``room`` for what is still; the number of triangles that move."""
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    # What moves, where it is at rest.
    shapes = {
        "glider": (glider(), "paper"),
        "ball": (sphere(BALL_START, BALL_RADIUS, 40), "polished"),
        "pinwheel": (pinwheel(PINWHEEL), "vane"),
    }
    movers, triangles = write_shapes(folder, shapes)
    bsdfs = (
        bsdf("paper", "diffuse", colour("reflectance", (0.82, 0.78, 0.66)))
        + bsdf("vane", "roughplastic", plastic((0.62, 0.12, 0.05), 0.15))
        + bsdf("polished", "roughconductor", metal((0.444, 0.527, 1.094), (3.695, 2.765, 1.829), 0.08))
    )
    still = "".join(ply_shape(name, material, "../room/") for name, (_, material) in room_shapes().items())
    still = (room_bsdfs() + still).replace('value="textures/', 'value="../room/textures/')
    text = head(512, 6, 60, (CAMERA, TARGET, (0, 0, 1))) + still + bsdfs + movers + room_lights()
    write_scene(folder, "room-moving", text, room_motion())
    return triangles


def sheet() -> Mesh:
    """The sheet at rest, in the plane y = 0."""
    x = np.linspace(-SHEET_WIDTH / 2, SHEET_WIDTH / 2, 49)
    z = np.linspace(SHEET_TOP - SHEET_HEIGHT, SHEET_TOP, 37)
    points = np.stack(np.broadcast_arrays(x[None, :], 0.0, z[:, None]), -1)
    return grid(points)


def cloth_motion() -> dict[str, Any]:
    """Waves run along the sheet, which swings the more the farther it is below the line."""
    below = f"({SHEET_TOP} - z) / {SHEET_HEIGHT}"
    phase = "2 * pi * (0.7 * x + 0.35 * z - 2 * t)"
    return {
        "seconds": 3,
        "shapes": {
            "sheet_shape": {
                "formula": [
                    f"x + 0.03 * {below} * cos({phase})",
                    f"0.16 * {below} * sin({phase}) + 0.12 * ({below}) ** 2 * sin(2 * pi * t)",
                    f"z + 0.05 * ({below}) ** 2 * cos({phase})",
                ]
            }
        },
    }


CLOTH_STILL: dict[str, Builtin] = {
    # name: (kind, material, transform)
    "floor": ("rectangle", "grey", ("scale 2.5 2.5 1",)),
    "back": ("rectangle", "ochre", ("scale 2.5 1.25 1", "rotate x 90", "translate 0 1.4 1.25")),
    "side": (
        "rectangle",
        "white",
        ("scale 2.5 1.25 1", "rotate x 90", "rotate z 90", "translate -1.9 0 1.25"),
    ),
    "chest": ("cube", "teal", ("scale 0.45 0.25 0.22", "rotate z 20", "translate 0.65 0.75 0.22")),
    "stool": ("cylinder", "ochre", ("scale 0.18 0.18 0.4", "translate -0.75 -0.7 0")),
    "seat": ("disk", "ochre", ("scale 0.18 0.18 1", "translate -0.75 -0.7 0.4")),
    "bowl": ("sphere", "glaze", ("scale 0.16 0.16 0.16", "translate 0.45 -0.75 0.16")),
    "line": (
        "cylinder",
        "white",
        ("scale 0.008 0.008 3.8", "rotate y 90", f"translate -1.9 0 {SHEET_TOP + 0.01}"),
    ),
}


def write_cloth(folder: Path) -> int:
    """Write the sheet and what is around it; the number of triangles that move."""
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    colours = {
        "grey": (0.42, 0.42, 0.4),
        "ochre": (0.62, 0.42, 0.18),
        "white": (0.72, 0.72, 0.7),
        "teal": (0.1, 0.33, 0.36),
        "linen": (0.78, 0.3, 0.22),
    }
    text = head(512, 6, 50, ((1.5, -3.1, 1.7), (-0.05, 0.1, 0.85), (0, 0, 1)))
    text += "".join(bsdf(name, "diffuse", colour("reflectance", value)) for name, value in colours.items())
    text += bsdf("glaze", "roughplastic", plastic((0.1, 0.16, 0.5), 0.1))
    text += builtin_shapes(CLOTH_STILL)
    shapes, triangles = write_shapes(folder, {"sheet": (sheet(), "linen")})
    light = '\t\t<emitter type="area">\n\t\t\t<rgb name="radiance" value="16, 15, 13" />\n\t\t</emitter>\n'
    steps = ("scale 0.5 0.35 1", "rotate x 155", "translate 0.6 -1.3 2.9")
    text += shapes + builtin_shapes({"light": ("rectangle", "white", steps)}, light)
    sky = (
        '\t<emitter type="constant" id="sky">\n'
        '\t\t<rgb name="radiance" value="0.25, 0.3, 0.38" />\n\t</emitter>\n'
    )
    write_scene(folder, "cloth", text + sky, cloth_motion())
    return triangles


def write_scene(folder: Path, name: str, text: str, motion: dict[str, Any]) -> None:
    """Write a scene and its motion."""
    (folder / f"{name}.xml").write_text(text + "</scene>\n", encoding="utf-8")
    (folder / f"{name}.motion.json").write_text(json.dumps(motion, indent=2) + "\n", encoding="utf-8")


def main() -> None:
    """Write both scenes."""
    for name, write in (("room-moving", write_room_moving), ("cloth", write_cloth)):
        print(f"{name}: {write(HERE / name)} triangles that move")


if __name__ == "__main__":
    main()
