"""Writes scenes of instances: a thicket of 1,143 small plants, and a plantation of 12 million triangles.

    python -m benchmarks.instanced_scenes FOLDER

They are made from numbers as those of `benchmarks.hard_scenes` are.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.hard_scenes import SceneWriter, diffuse, leaves
from scenes.write_scenes import Mesh, grid, merge, tube

_SEED = 5
_GREENS = ((0.12, 0.3, 0.06), (0.2, 0.36, 0.08), (0.32, 0.3, 0.07), (0.08, 0.22, 0.07))
_BARK = (0.25, 0.17, 0.11)
# Twigs of a plant, and where plants are: from the camera's feet on.
_TWIGS, _WIDE, _DEEP = 20, 24.0, 40.0


def write_instanced(folder: Path, instances: int, triangles: int) -> None:
    """Plants on a ground in sun and sky.

    Args:
        folder: of the scene; it is made.
        instances: how often plants stand there.
        triangles: of each of the four kinds of plants, about; at least 3,000.
    """
    rng = np.random.default_rng(_SEED)
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


SCENES = {"thicket": (1143, 3_000), "plantation": (120, 100_000)}


def main() -> None:
    """Writes every scene into a folder of its own."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    for name, (instances, triangles) in SCENES.items():
        write_instanced(options.folder / name, instances, triangles)


if __name__ == "__main__":
    main()
