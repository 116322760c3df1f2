"""Writes scenes that are not rooms: by default a grove, a stage under trusses, and a cluttered workshop.

    python -m benchmarks.hard_scenes FOLDER [NAME ...]

Further ones, of instances, are a thicket of 1,143 small plants and a plantation of 12 million triangles. They
are made from numbers and the pictures of `scenes/write_scenes.py`; a fixed seed makes every run write the
same. Units are metres, z points up.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.write_scenes import (
    Mesh,
    box,
    grid,
    merge,
    quad,
    rounded_box,
    save_ply,
    sphere,
    textures,
    tube,
    write_textures,
)

Points = NDArray[np.float64]
_SEED, _INSTANCED_SEED = 11, 5
# Colours of leaves.
_GREENS = ((0.12, 0.3, 0.06), (0.2, 0.36, 0.08), (0.32, 0.3, 0.07), (0.08, 0.22, 0.07))


class SceneWriter:
    """Shapes and lights of a scene file, with its meshes and textures beside it."""

    def __init__(self, folder: Path, eye: Sequence[float], target: Sequence[float], fov: float):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        looks = f'origin="{_row(eye)}" target="{_row(target)}" up="0 0 1"'
        self._lines = [
            '<scene version="3.0.0">',
            '<integrator type="path"/>',
            f'<sensor type="perspective"><float name="fov" value="{fov}"/>',
            f'<transform name="to_world"><lookat {looks}/></transform>',
            '<film type="hdrfilm"><integer name="width" value="512"/><integer name="height" value="512"/>',
            '<rfilter type="box"/></film></sensor>',
        ]
        self._meshes = 0

    def mesh(self, mesh: Mesh, bsdf: str) -> None:
        """A mesh with a BSDF element, and faces without smooth normals."""
        name = f"mesh-{self._meshes}.ply"
        self._meshes += 1
        rows = np.concatenate([mesh.points, mesh.uvs], axis=1).astype("<f4")
        save_ply(self.folder / name, ("x", "y", "z", "u", "v"), rows, mesh.faces)
        self._lines.append(
            f'<shape type="ply"><string name="filename" value="{name}"/>'
            f'<boolean name="face_normals" value="true"/>{bsdf}</shape>'
        )

    def lamp(self, place: Sequence[float], radius: float, radiance: Sequence[float] | Points) -> None:
        """A sphere that emits light."""
        self.add(
            f'<shape type="sphere"><point name="center" value="{_row(place)}"/>'
            f'<float name="radius" value="{radius}"/>'
            f'<emitter type="area"><rgb name="radiance" value="{_row(radiance)}"/></emitter></shape>'
        )

    def add(self, line: str) -> None:
        """Any other element."""
        self._lines.append(line)

    def close(self) -> None:
        """Writes the scene file."""
        (self.folder / "scene.xml").write_text("\n".join([*self._lines, "</scene>", ""]))


def _row(values: Sequence[float] | Points) -> str:
    return " ".join(f"{value:.5g}" for value in values)


def diffuse(colour: Sequence[float] | str) -> str:
    """A two-sided diffuse BSDF of a colour or of a texture file."""
    if isinstance(colour, str):
        file = f'<string name="filename" value="textures/{colour}"/>'
        inside = f'<texture type="bitmap" name="reflectance">{file}</texture>'
    else:
        inside = f'<rgb name="reflectance" value="{_row(colour)}"/>'
    return f'<bsdf type="twosided"><bsdf type="diffuse">{inside}</bsdf></bsdf>'


def rough_metal(alpha: float) -> str:
    """A brushed metal."""
    inside = f'<float name="alpha" value="{alpha}"/>'
    return f'<bsdf type="twosided"><bsdf type="roughconductor">{inside}</bsdf></bsdf>'


def leaves(rng: np.random.Generator, centres: Points, size: float) -> Mesh:
    """A diamond of two triangles about each centre, turned at random."""
    count = len(centres)
    along = rng.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    long, wide = size * rng.uniform(0.7, 1.3, (2, count, 1))
    corners = [centres - long * along, centres + 0.4 * wide * across, centres + long * along]
    corners.append(centres - 0.4 * wide * across)
    points = np.stack(corners, axis=1).reshape(-1, 3)
    first = 4 * np.arange(count)[:, None]
    faces = np.concatenate([np.add(first, (0, 1, 2)), np.add(first, (0, 2, 3))])
    return Mesh(points, np.zeros((len(points), 2)), faces)


def write_grove(folder: Path) -> None:
    """Fourteen trees of 1.4 million leaf triangles and blades of grass, in sun and sky."""
    rng = np.random.default_rng(_SEED)
    scene = SceneWriter(folder, (0.5, -9.0, 1.7), (0.0, 2.0, 2.6), 60)
    scene.add('<emitter type="constant"><rgb name="radiance" value=".5 .65 .9"/></emitter>')
    scene.add(
        '<emitter type="directional"><vector name="direction" value=".5 .6 -1"/>'
        '<rgb name="irradiance" value="4 3.6 3"/></emitter>'
    )
    x, y = np.meshgrid(np.linspace(-40, 40, 80), np.linspace(-30, 50, 80))
    scene.mesh(
        grid(np.stack([x, y, 0.15 * np.sin(0.6 * x) * np.cos(0.5 * y)], -1)), diffuse((0.2, 0.17, 0.1))
    )
    crowns: list[list[Mesh]] = [[] for _ in _GREENS]
    trunks = []
    for number in range(14):
        place = np.array([rng.uniform(-9, 9), rng.uniform(-2, 16), 0.0])
        tall = rng.uniform(3.5, 6.5)
        top = np.add(place, (rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), tall))
        trunks.append(tube([place, (place + top) / 2 + [0.1, 0, 0], top], [0.22, 0.12, 0.03], 24, 12))
        for _ in range(30):
            start = place + (top - place) * rng.uniform(0.35, 0.95)
            reach = rng.normal(size=3) * [1, 1, 0.5]
            end = start + reach / np.linalg.norm(reach) * rng.uniform(0.6, 1.8)
            trunks.append(tube([start, (start + end) / 2 + [0, 0, 0.1], end], [0.05, 0.01], 8, 6))
            centres = end + rng.normal(size=(1600, 3)) * 0.32
            crowns[number % len(_GREENS)].append(leaves(rng, centres, 0.05))
    scene.mesh(merge(trunks), diffuse((0.25, 0.17, 0.11)))
    for green, crown in zip(_GREENS, crowns, strict=True):
        scene.mesh(merge(crown), diffuse(green))
    blades = np.stack([rng.uniform(-10, 10, 60_000), rng.uniform(-8, 12, 60_000), np.full(60_000, 0.1)], -1)
    scene.mesh(leaves(rng, blades, 0.09), diffuse((0.18, 0.33, 0.07)))
    scene.close()


def write_gantry(folder: Path) -> None:
    """A stage under six trusses of thin bars with 390 small coloured lamps."""
    rng = np.random.default_rng(_SEED)
    scene = SceneWriter(folder, (1.0, -9.0, 1.8), (0.0, 2.0, 2.3), 58)
    scene.mesh(quad((-8, -10, 0), (16, 0, 0), (0, 17, 0)), diffuse((0.25, 0.23, 0.22)))
    folds = np.linspace(-8, 8, 400)
    heights = np.array([0.0, 7.0])
    cloth = np.stack(np.broadcast_arrays(folds, 6.5 + 0.12 * np.sin(9 * folds), heights[:, None]), -1)
    scene.mesh(grid(cloth), diffuse((0.35, 0.06, 0.08)))
    scene.mesh(
        merge([box((-6, 0, 0), (6, 6, 0.6)), box((-6, -0.4, 0), (6, 0, 0.3))]), diffuse((0.15, 0.13, 0.12))
    )
    bars = []
    for y, z in ((0.5, 4.6), (2.5, 4.9), (4.5, 5.2)):
        bars += _truss(np.array([-5.5, y, z]), np.array([5.5, y, z]))
    for x in (-5.5, 5.5):
        bars += _truss(np.array([x, 0.5, 0.6]), np.array([x, 0.5, 4.6]))
    bars += _truss(np.array([-5.5, 4.5, 0.6]), np.array([-5.5, 4.5, 5.2]))
    scene.mesh(merge(bars), rough_metal(0.3))
    things = [sphere((x, 3.4, 1.1), 0.35, 24) for x in (-1.2, -0.4, 0.4)]
    things += [box((2.0, 3.5, 0.6), (3.4, 4.2, 1.7)), box((-3.6, 3.4, 0.6), (-2.4, 4.1, 2.1))]
    scene.mesh(merge([*things, *_stands(rng)]), diffuse((0.3, 0.3, 0.32)))
    hues = np.array([[3, 0.6, 0.4], [0.5, 1.2, 3], [2.5, 2.2, 1.8], [2.6, 0.5, 2.2]])
    for number in range(390):
        row = ((0.5, 4.3), (2.5, 4.6), (4.5, 4.9))[number % 3]
        place = (rng.uniform(-5.4, 5.4), row[0] + rng.uniform(-0.2, 0.2), row[1] + rng.uniform(-0.05, 0.05))
        scene.lamp(place, 0.03, hues[rng.integers(len(hues))] * rng.uniform(8, 30))
    scene.close()


def _truss(start: Points, end: Points) -> list[Mesh]:
    """Four chords 0.3 m apart, with posts and diagonals between them."""
    ahead = (end - start) / np.linalg.norm(end - start)
    side = np.cross(ahead, [0.31, 0.95, 0.1] if abs(ahead[1]) < 0.9 else [1.0, 0, 0])
    side *= 0.15 / np.linalg.norm(side)
    over = np.cross(ahead, side)
    corners = [side + over, side - over, -side - over, -side + over]
    found = [_bar(start + corner, end + corner, 0.02) for corner in corners]
    steps = max(2, round(float(np.linalg.norm(end - start)) / 0.35))
    for number in range(steps):
        low, high = (start + (end - start) * share for share in (number / steps, (number + 1) / steps))
        for one, other in zip(corners, corners[1:] + corners[:1], strict=True):
            found += [_bar(low + one, high + other, 0.01), _bar(low + one, low + other, 0.01)]
    return found


def _bar(start: Points, end: Points, radius: float) -> Mesh:
    return tube([start, (start + end) / 2, end], [radius, radius], 3, 8)


def _stands(rng: np.random.Generator) -> list[Mesh]:
    found = []
    for x in np.linspace(-4.5, 4.5, 9):
        foot = np.array([x, rng.uniform(0.8, 2.4), 0.6])
        found += [_bar(foot, np.add(foot, (0, 0, 1.3)), 0.012)]
        found += [sphere(np.add(foot, (0, 0, 1.35)), 0.05, 12)]
        ends = (0.3, 0, 0), (-0.15, 0.26, 0), (-0.15, -0.26, 0)
        found += [_bar(foot, np.add(foot, end), 0.012) for end in ends]
    return found


def write_workshop(folder: Path) -> None:
    """A workshop of 230,000 triangles: shelves, tools, textured boxes; a sunny window and two lamps."""
    rng = np.random.default_rng(_SEED)
    scene = SceneWriter(folder, (1.0, 0.8, 1.7), (4.6, 4.2, 1.1), 65)
    pictures = textures()
    write_textures(folder, pictures)
    names = list(pictures)
    scene.mesh(quad((0, 0, 0), (6, 0, 0), (0, 5, 0), (0, 0, 4, 3)), diffuse("floor.jpg"))
    walls = [quad((0, 5, 0), (0, -5, 0), (0, 0, 3)), quad((6, 5, 0), (-6, 0, 0), (0, 0, 3))]
    walls += [quad((0, 0, 0), (6, 0, 0), (0, 0, 3)), quad((0, 0, 3), (0, 5, 0), (6, 0, 0))]
    # The window is a gap between y 1.5 and 3.5.
    walls += [quad((6, 0, 0), (0, 1.5, 0), (0, 0, 3)), quad((6, 3.5, 0), (0, 1.5, 0), (0, 0, 3))]
    walls += [quad((6, 1.5, 0), (0, 2, 0), (0, 0, 0.9)), quad((6, 1.5, 2.3), (0, 2, 0), (0, 0, 0.7))]
    scene.mesh(merge(walls), diffuse("wallpaper.jpg"))
    boards = [rounded_box((0.2, 4.25, z), (5.7, 4.75, z + 0.04), 0.01) for z in (0.4, 0.9, 1.4, 1.9, 2.35)]
    legs = [box((x, y, 0), (x + 0.08, y + 0.08, 0.88)) for x in (2.6, 5.2) for y in (1.4, 3.2)]
    top = rounded_box((2.4, 1.2, 0.88), (5.5, 3.5, 0.94), 0.02)
    scene.mesh(merge([*boards, *legs, top]), diffuse("wood.jpg"))
    for number in range(60):
        shelf = number % 5
        low = np.array([rng.uniform(0.3, 5.2), rng.uniform(4.3, 4.6), (0.45, 0.95, 1.45, 1.95, 2.4)[shelf]])
        high = np.add(low, (rng.uniform(0.1, 0.4), rng.uniform(0.1, 0.35), rng.uniform(0.08, 0.4)))
        scene.mesh(rounded_box(low, high, 0.015, 4, 3), diffuse(names[number % len(names)]))
    tools = []
    for _ in range(160):
        foot = np.array([rng.uniform(2.6, 5.2), rng.uniform(1.4, 3.2), 0.93])
        tip = foot + rng.normal(size=3) * [0.2, 0.2, 0.05]
        tools.append(tube([foot, (foot + tip) / 2 + [0, 0, 0.05], tip], [0.012, 0.02, 0.006], 24, 16))
    scene.mesh(merge(tools), rough_metal(0.2))
    balls = [sphere((rng.uniform(2.6, 5.2), rng.uniform(1.4, 3.2), 0.97), 0.05, 40) for _ in range(30)]
    scene.mesh(merge(balls), '<bsdf type="plastic"><rgb name="diffuse_reflectance" value=".6 .2 .1"/></bsdf>')
    cables = [
        tube([(x, 0.6, 0.02), (x + 0.6, 2, 0.03), (x + rng.uniform(-1, 1), 4, 0.02)], [0.012, 0.012], 200, 10)
        for x in np.linspace(0.4, 4.8, 12)
    ]
    scene.mesh(merge(cables), diffuse((0.08, 0.08, 0.09)))
    scene.mesh(_pegboard(rng), rough_metal(0.15))
    scene.add(
        '<emitter type="directional"><vector name="direction" value="-1 -.1 -.7"/>'
        '<rgb name="irradiance" value="14 12 9"/></emitter>'
        '<emitter type="constant"><rgb name="radiance" value=".8 1 1.4"/></emitter>'
    )
    for x in (2.0, 4.0):
        scene.lamp((x, 2.4, 2.5), 0.08, (60, 50, 38))
    scene.close()


def _pegboard(rng: np.random.Generator) -> Mesh:
    found = []
    for y in np.linspace(0.8, 4.0, 20):
        for z in np.linspace(1.0, 2.6, 8):
            foot = np.array([0.05, y, z])
            end = np.add(foot, (0.02, 0, -rng.uniform(0.1, 0.18)))
            knots = [foot, np.add(foot, (0.05, 0.03, -0.06)), end]
            found.append(tube(knots, [0.008, 0.015, 0.008], 30, 12))
    return merge(found)


_BARK = (0.25, 0.17, 0.11)
# Twigs of a plant, and where plants are: from the camera's feet on.
_TWIGS, _WIDE, _DEEP = 20, 24.0, 40.0


def write_instanced(folder: Path, instances: int, triangles: int) -> None:
    """So many plants in sun and sky, each of four kinds of about so many triangles, at least 3,000."""
    rng = np.random.default_rng(_INSTANCED_SEED)
    scene = SceneWriter(folder, (0.0, -1.5, 1.7), (0.0, 6.0, 1.3), 60)
    scales = "".join(f'<float name="{name}_scale" value="4"/>' for name in ("sun", "sky"))
    scene.add(f'<emitter type="sunsky"><vector name="sun_direction" value=".5 -.4 .6"/>{scales}</emitter>')
    x, y = np.meshgrid(np.linspace(-60, 60, 120), np.linspace(-20, 100, 120))
    scene.mesh(grid(np.stack([x, y, 0 * x], -1)), diffuse((0.2, 0.17, 0.1)))
    for number, green in enumerate(_GREENS):
        wood, crown = _plant(rng, triangles)
        scene.add(f'<shape type="shapegroup" id="plant-{number}">')
        scene.mesh(wood, diffuse(_BARK))
        scene.mesh(crown, diffuse(green))
        scene.add("</shape>")
    for number, (across, ahead) in enumerate(_places(rng, instances)):
        scene.add(
            f'<shape type="instance"><ref id="plant-{number % len(_GREENS)}"/><transform name="to_world">'
            f'<scale value="{rng.uniform(0.6, 1.3):.4f}"/><rotate z="1" angle="{rng.uniform(0, 360):.2f}"/>'
            f'<translate x="{across:.3f}" y="{ahead:.3f}"/></transform></shape>'
        )
    scene.close()


def _plant(rng: np.random.Generator, triangles: int) -> tuple[Mesh, Mesh]:
    """Wood and leaves of a plant two metres high, at the origin."""
    wood = [tube([(0, 0, 0), (0.04, 0, 0.9), (0, 0, 1.8)], [0.05, 0.01], 12, 6)]
    ends = []
    for height in np.linspace(0.3, 1.8, _TWIGS):
        angle, reach = rng.uniform(0, 2 * np.pi), 0.25 + 0.3 * (1.8 - height) * rng.uniform(0.5, 1)
        end = (reach * np.cos(angle), reach * np.sin(angle), height + 0.2)
        wood.append(
            tube([(0, 0, height), (0.5 * end[0], 0.5 * end[1], height + 0.14), end], [0.012, 0.003], 6, 4)
        )
        ends.append(end)
    stem = merge(wood)
    count = max(1, (triangles - len(stem.faces)) // 2)
    centres = np.array(ends)[rng.integers(_TWIGS, size=count)] + rng.normal(size=(count, 3)) * 0.13
    # As much leaf however many leaves there are.
    return stem, leaves(rng, centres, 2.2 / np.sqrt(count))


def _places(rng: np.random.Generator, count: int) -> Iterator[tuple[float, float]]:
    """So many places, evenly spread, of which none is at the camera."""
    columns = int(np.ceil(np.sqrt(count * _WIDE / _DEEP)))
    rows = -(-count // columns)
    for number in range(count):
        row, column = divmod(number, columns)
        shift = rng.uniform(0.2, 0.8, 2)
        yield _WIDE * ((column + shift[0]) / columns - 0.5), 1.5 + _DEEP * (row + shift[1]) / rows


# Those that are measured, and those of instances.
SCENES = {"grove": write_grove, "gantry": write_gantry, "workshop": write_workshop}
INSTANCED = {
    "thicket": partial(write_instanced, instances=1143, triangles=3_000),
    "plantation": partial(write_instanced, instances=120, triangles=100_000),
}


def main() -> None:
    """Writes each scene into a folder of its own."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME", default=[*SCENES])
    options = parser.parse_args()
    for name in options.names:
        (SCENES | INSTANCED)[name](options.folder / name)


if __name__ == "__main__":
    main()
