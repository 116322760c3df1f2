"""Write the three test scenes, ``room``, ``cornell`` and ``meadow``, next to this script.

``room`` is a furnished room of about 21,000 triangles, lit by a sun that comes in through the
window and by a point light under a lamp shade. ``cornell`` is the classical box. ``meadow`` is
open country under a sky with clouds: a hut, a pond, a fence and trees near and far, on ground
that reaches to the horizon. Everything is made here from numbers (no outside models or
pictures), and a fixed seed makes every run write the same scene:

    python scenes/write_scenes.py

Units are metres, z points up. The room spans x 0..5, y 0..4, z 0..2.7; the window is in the wall
at y = 4 and the camera looks from the corner near the origin towards the opposite one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image, ImageDraw, ImageFilter, ImageFont

HERE = Path(__file__).resolve().parent
SEED = 7

ROOM = np.array([5.0, 4.0, 2.7])
WINDOW_X, WINDOW_Z = (2.65, 4.05), (0.92, 2.22)
LAMP = np.array([3.25, 2.05, 1.80])
CAMERA = np.array([1.1, 1.1, 1.45])
TARGET = np.array([3.0, 2.07, 1.15])
SUN_DIRECTION = np.array([0.42, -0.78, -0.60])

Point = Sequence[float] | np.ndarray
Colour = tuple[int, int, int]


# ---------------------------------------------------------------------------------------------
# Meshes
# ---------------------------------------------------------------------------------------------


@dataclass
class Mesh:
    """Triangles: positions and texture coordinates per vertex, three indices per face."""

    points: np.ndarray
    uvs: np.ndarray
    faces: np.ndarray

    def moved(self, offset: Point) -> Mesh:
        """A copy shifted by ``offset``."""
        return Mesh(self.points + np.asarray(offset), self.uvs, self.faces)

    def turned(self, degrees: float, axis: str = "z") -> Mesh:
        """A copy turned around a coordinate axis through the origin."""
        angle = math.radians(degrees)
        i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        matrix = np.eye(3)
        matrix[i, i] = matrix[j, j] = math.cos(angle)
        matrix[i, j], matrix[j, i] = -math.sin(angle), math.sin(angle)
        return Mesh(self.points @ matrix.T, self.uvs, self.faces)

    def mapped(self, scale: float) -> Mesh:
        """A copy textured by projection along each face's main axis, ``scale`` metres a tile."""
        corners = self.points[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        axis = np.abs(normals).argmax(axis=1)
        horizontal = np.where(axis == 0, 1, 0)
        vertical = np.where(axis == 2, 1, 2)
        rows = np.arange(len(corners))
        u = corners[rows, :, horizontal] / scale
        v = corners[rows, :, vertical] / scale
        faces = np.arange(3 * len(corners)).reshape(-1, 3)
        return Mesh(corners.reshape(-1, 3), np.stack([u, v], -1).reshape(-1, 2), faces)


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """One mesh holding all of ``meshes``."""
    meshes = list(meshes)
    starts = np.cumsum([0] + [len(m.points) for m in meshes])
    return Mesh(
        np.concatenate([m.points for m in meshes]),
        np.concatenate([m.uvs for m in meshes]),
        np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=False)]),
    )


def grid(points: np.ndarray, uvs: np.ndarray | None = None) -> Mesh:
    """Two triangles per cell of a (rows, columns, 3) grid; empty triangles are left out."""
    rows, columns = points.shape[:2]
    if uvs is None:
        v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
        uvs = np.stack([u, v], -1)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2).reshape(-1, 3)
    flat = points.reshape(-1, 3).astype(float)
    p, q, r = (flat[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(q - p, r - p), axis=1)
    return Mesh(flat, uvs.reshape(-1, 2), faces[area > 1e-10])


def quad(corner: Point, right: Point, up: Point, uv: Point = (0, 0, 1, 1)) -> Mesh:
    """A rectangle that faces ``right`` x ``up``; ``uv`` is left, top, right, bottom."""
    o, r, t = (np.asarray(a, float) for a in (corner, right, up))
    left, top, far, bottom = uv
    points = np.array([[o, o + r], [o + t, o + r + t]])
    uvs = np.array([[[left, bottom], [far, bottom]], [[left, top], [far, top]]], float)
    return grid(points, uvs)


def box(low: Point, high: Point) -> Mesh:
    """An axis-aligned box seen from outside."""
    a, b = np.asarray(low, float), np.asarray(high, float)
    x, y, z = np.diag(b - a)
    return merge(
        [
            quad(a, x, z),
            quad(a + x, y, z),
            quad(b - z, -x, z),
            quad(a + y, -y, z),
            quad(a + z, x, y),
            quad(a + y, x, -y),
        ]
    )


def rounded_box(
    low: Point, high: Point, radius: float, steps: int = 3, inner: int = 1, puff: float = 0.0
) -> Mesh:
    """A box with rounded edges; ``puff`` swells its faces like those of a cushion."""
    a, b = np.asarray(low, float), np.asarray(high, float)
    half, centre = (b - a) / 2, (a + b) / 2
    ramp = 1 - np.tan(np.linspace(0, math.pi / 4, steps + 1))

    def ticks(k: int) -> np.ndarray:
        edge = half[k] - radius * ramp
        middle = np.linspace(-edge[0], edge[0], inner + 2)[1:-1]
        return np.concatenate([-edge[::-1], middle, edge])

    sides = []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        v, u = np.meshgrid(ticks(j), ticks(i), indexing="ij")
        for sign in (1, -1):
            p = np.empty((*u.shape, 3))
            p[..., i], p[..., j], p[..., k] = u * sign, v, half[k] * sign
            core = np.clip(p, -(half - radius), half - radius)
            out = p - core
            p = core + radius * out / np.linalg.norm(out, axis=-1, keepdims=True)
            swell = np.cos(0.5 * math.pi * u / half[i]) * np.cos(0.5 * math.pi * v / half[j])
            p[..., k] += sign * puff * swell
            sides.append(grid(p))
    return merge(sides).moved(centre)


def spline(knots: Sequence[Point], samples: int) -> np.ndarray:
    """Points on the Catmull-Rom curve through ``knots``."""
    k = np.asarray(knots, float)
    k = np.concatenate([[2 * k[0] - k[1]], k, [2 * k[-1] - k[-2]]])
    t = np.linspace(0, len(k) - 3, samples)
    i = np.minimum(t.astype(int), len(k) - 4)
    f = (t - i)[:, None]
    a, b, c, d = k[i], k[i + 1], k[i + 2], k[i + 3]
    return 0.5 * (2 * b + (c - a) * f + (2 * a - 5 * b + 4 * c - d) * f**2 + (3 * b - a - 3 * c + d) * f**3)


def revolve(profile: np.ndarray, segments: int) -> Mesh:
    """The surface of revolution of (radius, height) points that go upwards, seen from outside."""
    angle = np.linspace(0, 2 * math.pi, segments + 1)
    radius, height = np.maximum(profile[:, 0], 0), profile[:, 1]
    x, y = np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))
    z = np.broadcast_to(height[:, None], x.shape)
    mesh = grid(np.stack([x, y, z], -1))
    mesh.uvs[:, 1] = 1 - mesh.uvs[:, 1]
    return mesh


def turned_leg(knots: Sequence[Point], samples: int, segments: int) -> Mesh:
    """A turned post: smooth through ``knots``, closed at the top and the bottom."""
    curve = spline(knots, samples)
    ends = [[0, curve[0, 1]]], [[0, curve[-1, 1]]]
    return revolve(np.concatenate([ends[0], curve, ends[1]]), segments)


def sphere(centre: Point, radius: float, segments: int = 32) -> Mesh:
    """A ball with half as many rings as segments."""
    angle = np.linspace(-math.pi / 2, math.pi / 2, segments // 2 + 1)
    profile = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    return revolve(profile, segments).moved(centre)


def tube(knots: Sequence[Point], radii: Sequence[float], samples: int, segments: int) -> Mesh:
    """A round tube along the smooth curve through ``knots``; ``radii`` run from end to end."""
    curve = spline(knots, samples)
    radius = np.interp(np.linspace(0, 1, samples), np.linspace(0, 1, len(radii)), radii)
    ahead = np.gradient(curve, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    guide = np.array([0.0, 1.0, 0.0]) if np.abs(ahead[:, 1]).max() < 0.9 else np.array([1.0, 0, 0])
    side = np.cross(guide, ahead)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    over = np.cross(ahead, side)
    angle = np.linspace(0, 2 * math.pi, segments + 1)
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * over[:, None]
    return grid(curve[:, None] + radius[:, None, None] * ring)


def hoop(radius: float, thickness: float, samples: int, segments: int) -> Mesh:
    """A closed ring around the z axis."""
    angle = np.linspace(0, 2 * math.pi, segments + 1)
    around = radius + thickness * np.cos(angle), thickness * np.sin(angle)
    return revolve(np.stack(around, -1), samples)


def corner_normals(mesh: Mesh, crease: float) -> np.ndarray:
    """A normal for every corner of every face: smooth, but broken at edges above ``crease``."""
    p = mesh.points[mesh.faces]
    weighted = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    unit = weighted / np.linalg.norm(weighted, axis=1, keepdims=True)
    keys = np.round(p.reshape(-1, 3) * 1e5).astype(np.int64)
    place = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(place, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(place[order])) + 1)
    normals = np.empty((len(place), 3))
    limit = math.cos(math.radians(crease))
    for group in groups:
        face = group // 3
        near = unit[face] @ unit[face].T >= limit
        normals[group] = near @ weighted[face]
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def write_ply(path: Path, mesh: Mesh, crease: float = 50.0) -> int:
    """Write a binary PLY with normals and texture coordinates; the number of triangles."""
    corners = mesh.faces.ravel()
    columns = [mesh.points[corners], corner_normals(mesh, crease), mesh.uvs[corners]]
    rows = np.round(np.concatenate(columns, axis=1), 5).astype("<f4") + np.float32(0)
    vertices, index = np.unique(rows, axis=0, return_inverse=True)
    save_ply(path, ("x", "y", "z", "nx", "ny", "nz", "u", "v"), vertices, index.reshape(-1, 3))
    return len(mesh.faces)


def save_ply(path: Path, names: Sequence[str], vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Write a binary PLY of vertices, rows of float32 with a name for each column, and of their triangles."""
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, triangles
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {n}" for n in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    text = "\n".join([*header, "end_header"]) + "\n"
    path.write_bytes(text.encode("ascii") + vertices.tobytes() + faces.tobytes())


# ---------------------------------------------------------------------------------------------
# Textures
# ---------------------------------------------------------------------------------------------


def noise(rng: np.random.Generator, size: tuple[int, int], cells: tuple[int, int]) -> np.ndarray:
    """Smooth noise of about -1..1 in a (height, width) array, ``cells`` features each way."""
    coarse = rng.uniform(-1, 1, (cells[1], cells[0])).astype(np.float32)
    return np.asarray(Image.fromarray(coarse, mode=None).resize(size, Image.Resampling.BICUBIC))


def to_image(array: np.ndarray) -> Image.Image:
    """An RGB picture from sRGB values of 0..255."""
    return Image.fromarray(np.clip(array, 0, 255).astype(np.uint8), "RGB")


def centred(draw: ImageDraw.ImageDraw, at: Point, text: str, size: float, ink: Colour) -> None:
    """Draw ``text`` in bold with its middle ``at`` a point."""
    bold = max(1, round(size / 40))
    font = ImageFont.load_default(size)
    draw.text(tuple(at), text, ink, font, "mm", stroke_width=bold, stroke_fill=ink)


def floor_picture(rng: np.random.Generator) -> Image.Image:
    """Wooden boards for the whole floor, 1024 pixels along its 5 m."""
    width, height, board = 1024, 820, 26
    array = np.zeros((height, width, 3), np.float32)
    base = np.array([168, 122, 80], np.float32)
    for top in range(0, height, board):
        x = -int(rng.integers(0, 300))
        while x < width:
            length = int(rng.integers(220, 380))
            tone = base * rng.uniform(0.80, 1.14) + rng.uniform(-6, 6, 3)
            left, right = max(x, 0), min(x + length, width)
            rows = slice(top, min(top + board, height))
            if right > left:
                size = (right - left, rows.stop - rows.start)
                grain = 9 * noise(rng, size, (3, 9)) + 7 * noise(rng, size, (9, 13))
                array[rows, left:right] = tone + grain[..., None]
                array[rows, max(right - 2, 0) : right] *= 0.45
            x += length
        array[min(top + board, height) - 2 : top + board] *= 0.5
    return to_image(array)


def wood_picture(rng: np.random.Generator) -> Image.Image:
    """A plank of warm wood whose grain runs along v."""
    x = np.arange(512)[None] / 512
    bend = noise(rng, (512, 512), (5, 3))
    rings = np.sin(2 * math.pi * (9 * x + 1.1 * bend))
    fine = noise(rng, (512, 512), (70, 5))
    tone = 1 + 0.10 * rings + 0.08 * fine + 0.06 * noise(rng, (512, 512), (4, 2))
    return to_image(tone[..., None] * np.array([172, 118, 76]))


def wallpaper_picture(rng: np.random.Generator) -> Image.Image:
    """A tile of wallpaper: pale stripes, sprigs and dots; it repeats in both directions."""
    size = 512
    y, x = np.mgrid[0:size, 0:size] / size
    stripes = 0.5 + 0.5 * np.cos(2 * math.pi * 4 * x)
    ground = np.array([214, 212, 196]) + 12 * stripes[..., None]
    picture = to_image(ground + 0 * y[..., None])
    draw = ImageDraw.Draw(picture)
    for row in range(4):
        for column in range(4):
            cx = (column + 0.5 * (row % 2) + 0.25) * size / 4
            sprig(draw, cx, (row + 0.5) * size / 4)
            sprig(draw, cx - size, (row + 0.5) * size / 4)
    return picture.filter(ImageFilter.GaussianBlur(1.2))


def sprig(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
    """A small flower on a stem with two leaves."""
    leaf, petal, heart = (146, 164, 138), (190, 128, 112), (226, 186, 112)
    draw.line([(x, y - 6), (x, y + 40)], fill=leaf, width=6)
    draw.ellipse([x - 28, y + 8, x - 2, y + 24], fill=leaf)
    draw.ellipse([x + 2, y + 16, x + 28, y + 32], fill=leaf)
    for k in range(5):
        px, py = x + 15 * math.sin(1.2566 * k), y - 20 - 15 * math.cos(1.2566 * k)
        draw.ellipse([px - 10, py - 10, px + 10, py + 10], fill=petal)
    draw.ellipse([x - 8, y - 28, x + 8, y - 12], fill=heart)


def rug_picture() -> Image.Image:
    """A woven rug with borders, diamonds and a medallion."""
    w, h = 960, 640
    red, navy, sand, cream = (142, 46, 42), (38, 54, 92), (196, 158, 104), (226, 212, 182)
    picture = Image.new("RGB", (w, h), navy)
    draw = ImageDraw.Draw(picture)
    for inset, colour in ((14, sand), (24, red), (70, cream), (80, navy), (112, sand), (122, red)):
        draw.rectangle([inset, inset, w - inset, h - inset], fill=colour)
    for x in range(47, w - 30, 48):
        for y in (47, h - 47):
            diamond(draw, x, y, 18, sand, navy)
    for y in range(47, h - 30, 48):
        for x in (47, w - 47):
            diamond(draw, x, y, 18, sand, navy)
    for x in range(180, w - 150, 60):
        for y in range(170, h - 150, 60):
            diamond(draw, x, y, 13, sand if (x + y) % 40 else cream, navy)
    for size, colour in ((190, navy), (172, sand), (158, navy), (110, cream), (96, red)):
        diamond(draw, w / 2, h / 2, size, colour, colour)
    for k in range(8):
        angle = k * math.pi / 4
        x, y = w / 2 + 66 * math.cos(angle), h / 2 + 66 * math.sin(angle)
        draw.ellipse([x - 14, y - 14, x + 14, y + 14], fill=sand)
    draw.ellipse([w / 2 - 30, h / 2 - 30, w / 2 + 30, h / 2 + 30], fill=cream)
    return picture.filter(ImageFilter.GaussianBlur(1.0))


def diamond(draw: ImageDraw.ImageDraw, x: float, y: float, size: float, fill: Colour, heart: Colour) -> None:
    """A diamond with a smaller one in its middle."""
    for s, colour in ((size, fill), (0.45 * size, heart)):
        draw.polygon([(x - s, y), (x, y - s), (x + s, y), (x, y + s)], fill=colour)


TITLES = (
    "OPTICS", "LIGHT", "VISION", "FOVEA", "SPLATS", "RADIANCE", "PATHS", "COLOUR", "GEOMETRY",
    "NOISE", "SAMPLING", "CAMERAS", "SHADOWS", "MIRRORS", "LENSES", "WAVES", "ALGEBRA", "ATLAS",
    "BIRDS", "RIVERS", "POEMS", "CHESS", "BREAD", "GARDENS", "MUSIC", "HISTORY", "MAPS",
    "STARS", "TREES", "SAILING", "LETTERS", "FABLES",
)  # fmt: skip
BOOK_COLUMNS, BOOK_ROWS = 24, 4


def books_picture(rng: np.random.Generator) -> Image.Image:
    """An atlas of book spines, 24 by 4; the last rows of every cell are cover and paper."""
    cell_w, cell_h = 42, 256
    palette = [(142, 44, 40), (40, 76, 112), (52, 98, 70), (196, 156, 70), (96, 58, 92)]
    palette += [(214, 202, 176), (58, 58, 64), (176, 94, 50), (86, 130, 140), (120, 84, 58)]
    sheet = Image.new("RGB", (BOOK_COLUMNS * cell_w, BOOK_ROWS * cell_h))
    for k in range(BOOK_COLUMNS * BOOK_ROWS):
        cover = tuple(int(c * rng.uniform(0.85, 1.15)) for c in palette[rng.integers(10)])
        ink = (38, 34, 30) if sum(cover) > 380 else (236, 214, 160)
        title = TITLES[int(rng.integers(len(TITLES)))]
        spine = book_spine(cell_h, cell_w, cover, ink, title, int(rng.integers(3)))
        left, top = (k % BOOK_COLUMNS) * cell_w, (k // BOOK_COLUMNS) * cell_h
        sheet.paste(spine, (left, top))
    return sheet


def book_spine(height: int, width: int, cover: Colour, ink: Colour, title: str, style: int) -> Image.Image:
    """One spine with its title reading downwards."""
    lying = Image.new("RGB", (height, width), cover)
    draw = ImageDraw.Draw(lying)
    for x in ((22, 196), (14, 22, 200), (30, 206, 214))[style]:
        draw.rectangle([x, 0, x + 4, width], fill=ink)
    if style == 1:
        draw.rectangle([34, 5, 186, width - 6], outline=ink, width=2)
    size = 26.0
    while ImageFont.load_default(size).getlength(title) > 146:
        size -= 1
    centred(draw, (112, width / 2 - 1), title, size, ink)
    draw.rectangle([height - 12, 0, height, width], fill=(226, 216, 192))
    return lying.transpose(Image.Transpose.ROTATE_270)


def landscape_picture(rng: np.random.Generator) -> Image.Image:
    """A painting of hills, a lake and a low sun."""
    w, h = 512, 384
    t = np.linspace(0, 1, h)[:, None, None]
    sky = (1 - t) * np.array([72, 112, 168]) + t * np.array([250, 206, 150])
    picture = to_image(np.broadcast_to(sky, (h, w, 3)))
    draw = ImageDraw.Draw(picture)
    draw.ellipse([330, 110, 390, 170], fill=(255, 238, 190))
    colours = [(112, 122, 150), (86, 108, 112), (66, 98, 70), (48, 74, 46)]
    for k, colour in enumerate(colours):
        line = 190 + 46 * k + 34 * noise(rng, (w, 1), (4 + 2 * k, 1))[0]
        draw.polygon([(0, h), *enumerate(line.tolist()), (w, h)], fill=colour)
    draw.ellipse([120, 268, 330, 312], fill=(150, 178, 196))
    for x in (60, 96, 400, 452, 480):
        y = 330 + (x * 7) % 30
        draw.polygon([(x - 22, y), (x, y - 96), (x + 22, y)], fill=(28, 52, 36))
    return picture.filter(ImageFilter.GaussianBlur(0.8))


def blocks_picture() -> Image.Image:
    """An abstract painting: coloured blocks between black lines."""
    picture = Image.new("RGB", (384, 512), (238, 232, 220))
    draw = ImageDraw.Draw(picture)
    for area, colour in (
        ((0, 0, 130, 170), (196, 44, 38)),
        ((250, 60, 384, 210), (36, 74, 150)),
        ((0, 330, 90, 512), (240, 196, 60)),
        ((140, 380, 260, 512), (36, 74, 150)),
        ((270, 300, 384, 400), (240, 196, 60)),
        ((300, 430, 384, 512), (196, 44, 38)),
    ):
        draw.rectangle(area, fill=colour)
    for x in (130, 260):
        draw.rectangle([x - 6, 0, x + 6, 512], fill=(24, 24, 26))
    for y in (60, 170, 300, 400):
        draw.rectangle([0, y - 6, 384, y + 6], fill=(24, 24, 26))
    return picture


def rings_picture() -> Image.Image:
    """A print of overlapping circles."""
    picture = Image.new("RGB", (512, 384), (228, 220, 204))
    colours = [(30, 92, 110), (214, 120, 62), (178, 52, 60), (232, 184, 84), (70, 60, 96)]
    draw = ImageDraw.Draw(picture)
    for k in range(15):
        x, y = 64 + 96 * (k % 5), 72 + 120 * (k // 5)
        for ring, radius in enumerate((46, 36, 26, 14)):
            colour = colours[(k + 2 * ring + k // 5) % 5]
            draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=colour)
    return picture.filter(ImageFilter.GaussianBlur(0.7))


def eye_chart_picture() -> Image.Image:
    """A poster with rows of letters that get smaller."""
    picture = Image.new("RGB", (512, 768), (240, 238, 230))
    draw = ImageDraw.Draw(picture)
    draw.rectangle([12, 12, 499, 755], outline=(60, 70, 84), width=4)
    rows = ("E", "F P", "T O Z", "L P E D", "P E C F D", "E D F C Z P", "F E L O P Z D")
    places = ((190, 116), (128, 262), (96, 372), (76, 462), (62, 554), (48, 626), (38, 690))
    for letters, (size, y) in zip(rows, places, strict=True):
        centred(draw, (256, y), letters, size, (24, 24, 28))
    draw.rectangle([60, 506, 452, 515], fill=(40, 130, 70))
    draw.rectangle([60, 724, 452, 733], fill=(186, 40, 40))
    return picture


def clock_picture() -> Image.Image:
    """A clock face that shows ten past ten."""
    picture = Image.new("RGB", (512, 512), (242, 238, 226))
    draw = ImageDraw.Draw(picture)
    draw.ellipse([8, 8, 503, 503], outline=(40, 42, 50), width=10)
    for k in range(60):
        angle = k * math.pi / 30
        inner, width = (206, 10) if k % 5 == 0 else (218, 4)
        ends = [256 + s * r for r in (inner, 232) for s in (math.sin(angle), -math.cos(angle))]
        draw.line(ends, fill=(40, 42, 50), width=width)
    for k in range(1, 13):
        at = (256 + 172 * math.sin(k * math.pi / 6), 256 - 172 * math.cos(k * math.pi / 6))
        centred(draw, at, str(k), 58, (30, 32, 40))
    for degrees, length, width in ((305, 110, 18), (60, 160, 12), (200, 176, 5)):
        x, y = math.sin(math.radians(degrees)), -math.cos(math.radians(degrees))
        colour = (190, 40, 36) if width == 5 else (30, 32, 40)
        draw.line([256, 256, 256 + length * x, 256 + length * y], fill=colour, width=width)
    draw.ellipse([240, 240, 272, 272], fill=(30, 32, 40))
    return picture


def fabric_picture(rng: np.random.Generator) -> Image.Image:
    """A repeating weave of soft zigzags."""
    y, x = np.mgrid[0:256, 0:256] / 256
    zigzag = np.abs((4 * x) % 1 - 0.5)
    band = np.sin(2 * math.pi * (6 * y + 1.5 * zigzag))
    tone = 1 + 0.13 * np.tanh(2.5 * band) + 0.03 * noise(rng, (256, 256), (64, 64))
    return to_image(tone[..., None] * np.array([92, 122, 134]))


def stripes_picture() -> Image.Image:
    """Striped cloth for cushions."""
    y, x = np.mgrid[0:256, 0:256] / 256
    pick = np.tanh(6 * np.sin(2 * math.pi * 5 * x))[..., None] * 0.5 + 0.5
    thin = np.tanh(6 * (np.sin(2 * math.pi * (5 * x + 0.25)) - 0.75))[..., None] * 0.5 + 0.5
    cloth = pick * np.array([222, 168, 74]) + (1 - pick) * np.array([232, 224, 206])
    return to_image((1 - thin) * cloth + thin * np.array([150, 56, 44]) + 0 * y[..., None])


def vase_picture() -> Image.Image:
    """Blue and white pottery, wrapped once around the vase."""
    picture = Image.new("RGB", (768, 512), (232, 234, 232))
    draw = ImageDraw.Draw(picture)
    blue, pale = (34, 64, 140), (112, 142, 196)
    for y, thick in ((40, 16), (70, 6), (330, 8), (440, 14), (474, 8)):
        draw.rectangle([0, y, 768, y + thick], fill=blue)
    for k in range(6):
        x = 64 + 128 * k
        for p in range(8):
            px, py = x + 34 * math.cos(p * math.pi / 4), 200 + 44 * math.sin(p * math.pi / 4)
            draw.ellipse([px - 15, py - 18, px + 15, py + 18], fill=blue)
        draw.ellipse([x - 18, 178, x + 18, 222], fill=pale)
        diamond(draw, x + 64, 200, 24, pale, blue)
        draw.arc([x - 64, 90, x + 64, 150], 0, 180, fill=blue, width=7)
        draw.ellipse([x - 24, 366, x + 24, 414], fill=pale, outline=blue, width=5)
    return picture.filter(ImageFilter.GaussianBlur(0.8))


def page_picture() -> Image.Image:
    """An open newspaper: headline, picture and columns of grey lines."""
    picture = Image.new("RGB", (512, 384), (232, 228, 216))
    draw = ImageDraw.Draw(picture)
    centred(draw, (256, 40), "THE DAILY PHOTON", 48, (30, 30, 34))
    draw.rectangle([20, 70, 492, 75], fill=(30, 30, 34))
    draw.rectangle([184, 92, 492, 232], fill=(120, 134, 146))
    draw.polygon([(184, 232), (290, 130), (360, 200), (420, 150), (492, 232)], fill=(62, 74, 70))
    draw.ellipse([410, 104, 446, 140], fill=(232, 228, 216))
    for x in (20, 184, 348):
        for y in range(96 if x == 20 else 248, 366, 14):
            draw.rectangle([x, y, x + 144 - (y * 37) % 40, y + 5], fill=(110, 108, 104))
    return picture


def outdoors_picture(rng: np.random.Generator) -> Image.Image:
    """The view out of the window, in angles: 90 degrees wide, 45 high, horizon at 18 from below."""
    w, h = 1024, 512
    t = np.linspace(0, 1, h)[:, None, None]
    sky = (1 - t) * np.array([120, 166, 214]) + t * np.array([206, 222, 232])
    cloud = 0.6 * noise(rng, (w, h), (9, 7)) + 0.4 * noise(rng, (w, h), (24, 18))
    cover = np.clip(2.2 * cloud[..., None] - 0.2, 0, 1)
    picture = to_image(sky * (1 - cover) + np.array([238, 240, 240]) * cover)
    draw = ImageDraw.Draw(picture)
    colours = [(134, 158, 172), (112, 146, 112), (104, 150, 76), (128, 164, 82)]
    for k, colour in enumerate(colours):
        line = 268 + 28 * k + (22 - 4 * k) * noise(rng, (w, 1), (7 + 2 * k, 1))[0]
        draw.polygon([(0, h), *enumerate(line.tolist()), (w, h)], fill=colour)
    for x in range(40, w, 150):
        farmhouse(draw, x + int(rng.integers(-20, 20)), 348 + int(rng.integers(-8, 24)))
    for _ in range(40):
        x, y = rng.uniform(0, w), rng.uniform(320, 420)
        r = 9 + (y - 320) * 0.16
        draw.rectangle([x - 2, y, x + 2, y + 1.6 * r], fill=(92, 70, 50))
        draw.ellipse([x - r, y - 1.4 * r, x + r, y + 0.7 * r], fill=(64, 104, 56))
    return picture.filter(ImageFilter.GaussianBlur(0.8))


def farmhouse(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
    """A small house with a red roof."""
    draw.rectangle([x - 24, y - 24, x + 24, y], fill=(232, 220, 196))
    draw.polygon([(x - 30, y - 24), (x, y - 48), (x + 30, y - 24)], fill=(182, 82, 58))
    for dx in (-14, 6):
        draw.rectangle([x + dx, y - 17, x + dx + 8, y - 7], fill=(82, 96, 112))


def globe_picture(rng: np.random.Generator) -> Image.Image:
    """Seas and lands of a made-up planet, with its meridians and parallels."""
    w, h = 512, 256
    land = noise(rng, (w, h), (9, 6)) + 0.4 * noise(rng, (w, h), (30, 18))
    seam = np.clip(np.minimum(np.arange(w), w - 1 - np.arange(w)) / 40, 0, 1)
    land = land * seam - 0.4 * (1 - seam)
    tone = np.clip((land + 0.4) / 1.4, 0, 1)[..., None]
    ground = (1 - tone) * np.array([96, 138, 72]) + tone * np.array([206, 176, 112])
    sea = np.array([62, 112, 158]) + 40 * tone
    picture = to_image(np.where(land[..., None] > 0.08, ground, sea))
    draw = ImageDraw.Draw(picture)
    for x in range(0, w, 64):
        draw.line([x, 0, x, h], fill=(226, 226, 214), width=2)
    for y in range(32, h, 32):
        draw.line([0, y, w, y], fill=(226, 226, 214), width=2)
    return picture.filter(ImageFilter.GaussianBlur(0.7))


def textures() -> dict[str, Image.Image]:
    """All pictures of the room by file name; each draws from its own random stream."""
    streams = iter(np.random.default_rng(SEED).spawn(8))
    return {
        "floor.jpg": floor_picture(next(streams)),
        "wood.jpg": wood_picture(next(streams)),
        "wallpaper.jpg": wallpaper_picture(next(streams)),
        "books.jpg": books_picture(next(streams)),
        "landscape.jpg": landscape_picture(next(streams)),
        "fabric.jpg": fabric_picture(next(streams)),
        "outdoors.jpg": outdoors_picture(next(streams)),
        "globe.jpg": globe_picture(next(streams)),
        "rug.jpg": rug_picture(),
        "blocks.png": blocks_picture(),
        "rings.jpg": rings_picture(),
        "eye_chart.png": eye_chart_picture(),
        "clock.png": clock_picture(),
        "stripes.png": stripes_picture(),
        "vase.jpg": vase_picture(),
        "page.png": page_picture(),
    }


# ---------------------------------------------------------------------------------------------
# Furniture; every function returns shapes as {name: (mesh, bsdf)}
# ---------------------------------------------------------------------------------------------

Shapes = dict[str, tuple[Mesh, str]]


def wallpaper(corner: Point, right: Point, up: Point) -> Mesh:
    """A piece of papered wall; the pattern hangs on from piece to piece, 0.8 m a tile."""
    o, r, t = (np.asarray(a, float) for a in (corner, right, up))
    along = r / np.linalg.norm(r)
    u0, v0 = float(o @ along) / 0.8, (ROOM[2] - o[2]) / 0.8
    return quad(o, r, t, (u0, v0 - t[2] / 0.8, u0 + np.linalg.norm(r) / 0.8, v0))


def shell() -> Shapes:
    """Floor, ceiling and the four walls, one of them with the hole of the window."""
    x, y, z = np.diag(ROOM)
    (x0, x1), (z0, z1) = WINDOW_X, WINDOW_Z
    far = [0, ROOM[1], 0]
    walls = [
        wallpaper([0, 0, 0], y, z),
        wallpaper([ROOM[0], ROOM[1], 0], -y, z),
        wallpaper([ROOM[0], 0, 0], -x, z),
        wallpaper(far, [x0, 0, 0], z),
        wallpaper([x1, ROOM[1], 0], [ROOM[0] - x1, 0, 0], z),
        wallpaper([x0, ROOM[1], 0], [x1 - x0, 0, 0], [0, 0, z0]),
        wallpaper([x0, ROOM[1], z1], [x1 - x0, 0, 0], [0, 0, ROOM[2] - z1]),
    ]
    h, d = 0.09, 0.015
    skirting = [
        box([0, 0, 0], [d, ROOM[1], h]),
        box([ROOM[0] - d, 0, 0], [ROOM[0], ROOM[1], h]),
        box([d, 0, 0], [ROOM[0] - d, d, h]),
        box([d, ROOM[1] - d, 0], [ROOM[0] - d, ROOM[1], h]),
    ]
    return {
        "floor": (quad([0, 0, 0], x, y), "floor"),
        "ceiling": (quad([0, ROOM[1], ROOM[2]], x, -y), "plaster"),
        "walls": (merge(walls), "wallpaper"),
        "skirting": (merge(skirting), "white_paint"),
    }


def window() -> Shapes:
    """The reveal, the frame with its bars, the sill and the curtains."""
    (x0, x1), (z0, z1), y, d = WINDOW_X, WINDOW_Z, ROOM[1], 0.22
    wide, tall, deep = [x1 - x0, 0, 0], [0, 0, z1 - z0], [0, d, 0]
    reveal = [
        quad([x0, y, z0], wide, deep),
        quad([x0, y + d, z1], wide, [0, -d, 0]),
        quad([x0, y, z0], deep, tall),
        quad([x1, y + d, z0], [0, -d, 0], tall),
    ]
    bars, near, back, b = [], y + 0.10, y + 0.15, 0.045
    bars += [box([x, near, z0], [x + b, back, z1]) for x in (x0, x1 - b)]
    bars += [box([x0 + b, near, z], [x1 - b, back, z + b]) for z in (z0, z1 - b)]
    middle, upper = (x0 + x1) / 2, z0 + 0.68 * (z1 - z0)
    bars += [box([middle - 0.02, near + 0.01, z0 + b], [middle + 0.02, back - 0.01, z1 - b])]
    bars += [box([x0 + b, near + 0.012, upper], [x1 - b, back - 0.012, upper + 0.03])]
    sill = rounded_box([x0 - 0.06, y - 0.10, z0 - 0.035], [x1 + 0.06, y + 0.005, z0], 0.012, 1, 0)
    rod = tube([[x0 - 0.4, y - 0.09, 2.4], [x1 + 0.35, y - 0.09, 2.4]], [0.012], 2, 8)
    knobs = [sphere([x, y - 0.09, 2.4], 0.03, 10) for x in (x0 - 0.4, x1 + 0.35)]
    cloths = [curtain(x0 - 0.36, x0 + 0.0), curtain(x1 - 0.02, x1 + 0.3)]
    return {
        "window_reveal": (merge(reveal), "white_paint"),
        "window_frame": (merge([*bars, sill]), "white_paint"),
        "curtain_rod": (merge([rod, *knobs]), "brass"),
        "curtains": (merge(cloths), "curtain"),
    }


def curtain(left: float, right: float) -> Mesh:
    """A hanging cloth with folds that widen downwards."""
    s, t = np.meshgrid(np.linspace(0, 1, 48), np.linspace(0, 1, 6))
    depth = (0.018 + 0.022 * t) * np.sin(2 * math.pi * 5.5 * s + 0.5 * np.sin(3 * t))
    x = left + (right - left) * s
    points = np.stack([x, ROOM[1] - 0.085 + depth, 2.4 - 2.3 * t], -1)
    return grid(points[::-1])


def backdrop() -> Shapes:
    """The painted country outside: a slope that leans back into the sun and lets it pass."""
    normal, through = np.array([-0.66, -0.40, 0.64]), np.array([5.6, 5.6, 0.0])
    degrees_right, degrees_up = np.linspace(81, 21, 13), np.array([-35, -17.5, 0, 14, 26.5, 30])
    up, right = np.meshgrid(degrees_up, degrees_right, indexing="ij")
    e, a = np.radians(up), np.radians(right)
    ray = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    distance = ((through - CAMERA) @ normal) / (ray @ normal)
    uvs = np.stack([(90 - right) / 90, np.clip((27 - up) / 45, 0.01, 0.99)], -1)
    return {"outdoors": (grid(CAMERA + distance[..., None] * ray, uvs), "outdoors")}


LEG = (
    (0.016, 0.0), (0.026, 0.05), (0.020, 0.10), (0.024, 0.14), (0.035, 0.20), (0.024, 0.27),
    (0.021, 0.36), (0.030, 0.48), (0.022, 0.55), (0.036, 0.60), (0.030, 0.64), (0.036, 0.70),
)  # fmt: skip


def table() -> Shapes:
    """A table with four turned legs, and the rug below it."""
    x0, x1, y0, y1 = 2.70, 3.80, 1.65, 2.45
    top = rounded_box([x0, y0, 0.715], [x1, y1, 0.75], 0.014, 1, 0).mapped(0.7)
    apron = [box([x0 + 0.08, y, 0.62], [x1 - 0.08, y + 0.02, 0.715]) for y in (y0 + 0.07, y1 - 0.09)]
    apron += [box([x, y0 + 0.08, 0.62], [x + 0.02, y1 - 0.08, 0.715]) for x in (x0 + 0.07, x1 - 0.09)]
    leg = turned_leg(LEG, 17, 11)
    places = [(x, y) for x in (x0 + 0.08, x1 - 0.08) for y in (y0 + 0.08, y1 - 0.08)]
    legs = [leg.moved([x, y, 0.012]) for x, y in places]
    rug = quad([2.15, 1.25, 0.012], [2.4, 0, 0], [0, 1.6, 0])
    hem = box([2.15, 1.25, 0.001], [4.55, 2.85, 0.011])
    return {
        "table_top": (top, "lacquered_wood"),
        "table_legs": (merge([*legs, *(a.mapped(0.7) for a in apron)]), "wood"),
        "rug": (rug, "rug"),
        "rug_hem": (hem, "rug_hem"),
    }


def chair(at: Point, degrees: float) -> Mesh:
    """A chair whose sitter looks along +y before it is turned."""
    seat = rounded_box([-0.21, -0.2, 0.43], [0.21, 0.22, 0.465], 0.016, 1, 0).mapped(0.7)
    knots = [(0.014, 0), (0.022, 0.05), (0.016, 0.1), (0.024, 0.25), (0.018, 0.36), (0.024, 0.43)]
    leg = turned_leg(knots, 10, 8)
    parts = [seat] + [leg.moved([x, 0.18, 0]) for x in (-0.17, 0.17)]
    for x in (-0.185, 0.185):
        post = [[x, -0.20, 0], [x, -0.18, 0.45], [x, -0.22, 0.75], [x, -0.27, 0.98]]
        parts.append(tube(post, [0.017, 0.02, 0.018, 0.014], 7, 8))
        parts.append(sphere([x, -0.27, 0.985], 0.019, 8))
    for z, y in ((0.62, -0.2), (0.74, -0.217), (0.86, -0.24)):
        slat = [[-0.185, y, z], [0, y - 0.035, z], [0.185, y, z]]
        parts.append(ribbon(slat, 0.06))
    for x in (-0.175, 0.175):
        parts.append(tube([[x, -0.18, 0.2], [x, 0.18, 0.2]], [0.011], 2, 6))
    return merge(parts).turned(degrees).moved(at)


def ribbon(knots: Sequence[Point], height: float) -> Mesh:
    """A bent slat, 16 mm thick, that follows ``knots`` and is ``height`` tall."""
    curve = spline(knots, 7)
    rise = np.array([0, 0, height / 2])
    low, high = curve - rise, curve + rise
    back = np.array([0, 0.016, 0])
    loop = np.stack([low, low + back, high + back, high, low], 1)
    return grid(loop)


def chairs() -> Shapes:
    """Two chairs at the table."""
    both = [chair([3.42, 1.40, 0.012], 12), chair([4.12, 2.02, 0.012], 97)]
    return {"chairs": (merge(both), "wood")}


def sofa() -> Shapes:
    """A sofa below the window with two striped cushions."""
    x0, x1, y0, y1 = 2.30, 4.10, 3.02, 3.86
    body = [
        rounded_box([x0 + 0.14, y0 + 0.03, 0.09], [x1 - 0.14, y1 - 0.1, 0.30], 0.03, 2, 0),
        rounded_box([x0, y0, 0.09], [x0 + 0.2, y1, 0.60], 0.085, 2, 0),
        rounded_box([x1 - 0.2, y0, 0.09], [x1, y1, 0.60], 0.085, 2, 0),
        rounded_box([x0 + 0.1, y1 - 0.2, 0.09], [x1 - 0.1, y1, 0.80], 0.07, 2, 0),
    ]
    middle = (x0 + x1) / 2
    for left, right in ((x0 + 0.19, middle - 0.004), (middle + 0.004, x1 - 0.19)):
        low, high = [left, y0 - 0.01, 0.295], [right, y1 - 0.2, 0.43]
        body.append(rounded_box(low, high, 0.05, 2, 1, 0.025))
        back = rounded_box([left, -0.09, -0.2], [right, 0.09, 0.2], 0.06, 2, 1, 0.03)
        body.append(back.turned(-10, "x").moved([0, y1 - 0.26, 0.63]))
    feet = [(x, y) for x in (x0 + 0.1, x1 - 0.1) for y in (y0 + 0.08, y1 - 0.08)]
    post = turned_leg([(0.018, 0.0), (0.03, 0.05), (0.026, 0.1)], 3, 8)
    return {
        "sofa": (merge(body).mapped(0.3), "fabric"),
        "sofa_feet": (merge([post.moved([x, y, 0]) for x, y in feet]), "wood"),
        "cushions": (merge(cushions(x0, x1, y1)), "stripes"),
    }


def cushions(x0: float, x1: float, y1: float) -> list[Mesh]:
    """Two loose cushions that lean in the corners of the sofa."""
    pillow = rounded_box([-0.2, -0.045, -0.2], [0.2, 0.045, 0.2], 0.035, 1, 4, 0.05).mapped(0.4)
    left = pillow.turned(-22, "x").turned(28).moved([x0 + 0.42, y1 - 0.40, 0.64])
    right = pillow.turned(-24, "x").turned(-24).moved([x1 - 0.44, y1 - 0.40, 0.64])
    return [left, right]


SHELF_X, SHELF_Y, SHELF_TOP = (4.69, 4.985), (2.16, 3.30), 1.95
SHELF_Z = (0.08, 0.46, 0.84, 1.20, 1.56)


def bookshelf(rng: np.random.Generator) -> Shapes:
    """A bookshelf full of books, with a few ornaments in the gaps and on top."""
    (x0, x1), (y0, y1), t = SHELF_X, SHELF_Y, 0.025
    boards = [box([x0, y, 0], [x1, y + t, SHELF_TOP]) for y in (y0, y1 - t)]
    boards += [box([x0 + 0.005, y0 + t, z - t], [x1, y1 - t, z]) for z in SHELF_Z]
    boards += [box([x0 - 0.02, y0 - 0.02, SHELF_TOP], [x1, y1 + 0.02, SHELF_TOP + 0.03])]
    boards += [box([x1 - 0.012, y0 + t, SHELF_Z[0]], [x1 - 0.001, y1 - t, SHELF_TOP])]
    boards += [box([x0 + 0.03, y0 + t, 0.0], [x0 + 0.05, y1 - t, SHELF_Z[0] - t])]
    gaps = {1: (2.50, 2.74), 3: (2.86, 3.12), 4: (2.18, 2.42)}
    cells = iter(rng.permutation(BOOK_COLUMNS * BOOK_ROWS))
    books = []
    for level, z in enumerate(SHELF_Z):
        books += book_row(rng, cells, z, gaps.get(level))
    pot = spline([(0.04, 0), (0.075, 0.06), (0.07, 0.13), (0.035, 0.19), (0.045, 0.22)], 10)
    small = revolve(np.concatenate([[[0, 0]], pot]), 18)
    globe = sphere([4.82, 3.1, SHELF_TOP + 0.22], 0.13, 22)
    stand = revolve(np.array([[0.09, 0], [0.085, 0.015], [0.02, 0.03], [0.015, 0.1]]), 20)
    return {
        "shelf": (merge(boards).mapped(0.7), "wood"),
        "books": (merge(books), "books"),
        "shelf_vase": (small.moved([4.80, 2.99, SHELF_Z[3] + 0.001]), "red_glaze"),
        "gold_ball": (sphere([4.80, 2.30, SHELF_Z[4] + 0.086], 0.085, 18), "gold"),
        "shelf_ball": (sphere([4.79, 2.62, SHELF_Z[1] + 0.096], 0.095, 18), "green_glaze"),
        "globe": (globe, "globe"),
        "globe_stand": (stand.moved([4.82, 3.1, SHELF_TOP + 0.03]), "brass"),
    }


def book_row(
    rng: np.random.Generator, cells: Iterable[int], z: float, gap: tuple[float, float] | None
) -> list[Mesh]:
    """Books from end to end of one shelf board, but for the gap."""
    y, row = SHELF_Y[1] - 0.03, []
    while True:
        width = rng.uniform(0.042, 0.075)
        if gap and y - width < gap[1] and y > gap[0]:
            y = gap[0]
        if y - width < SHELF_Y[0] + 0.028:
            return row
        tall, front = rng.uniform(0.22, 0.31), 4.71 + rng.uniform(0, 0.03)
        row.append(book([front, y - width, z], [front + 0.19, y - 0.001, z + tall], next(cells)))
        y -= width


def book(low: Point, high: Point, cell: int) -> Mesh:
    """A book whose spine faces -x; covers and pages take their colours from the cell's foot."""
    column, row = cell % BOOK_COLUMNS, cell // BOOK_COLUMNS
    du, dv = 1 / BOOK_COLUMNS, 1 / BOOK_ROWS
    spine = (column + 0.04) * du, (row + 0.01) * dv, (column + 0.96) * du, (row + 0.94) * dv
    cover = (column + 0.5) * du, (row + 0.905) * dv
    paper = (column + 0.5) * du, (row + 0.98) * dv
    mesh = box(low, high)
    mesh.uvs[:] = cover
    mesh.uvs[16:20] = paper
    front = [low[0], high[1], low[2]]
    size = [0, low[1] - high[1], 0], [0, 0, high[2] - low[2]]
    mesh.uvs[12:16] = quad(front, *size, spine).uvs
    return mesh


def sideboard() -> Shapes:
    """A lacquered sideboard with brass knobs; a vase and a chrome ball stand on it."""
    x0, x1, y0, y1 = 4.55, 4.98, 0.72, 1.98
    body = [rounded_box([x0, y0, 0.12], [x1, y1, 0.72], 0.012, 1, 0)]
    for k in range(3):
        left = y0 + 0.03 + k * 0.402
        body.append(rounded_box([x0 - 0.018, left, 0.16], [x0, left + 0.39, 0.68], 0.008, 1, 0))
    top = rounded_box([x0 - 0.03, y0 - 0.02, 0.72], [x1, y1 + 0.02, 0.75], 0.01, 1, 0).mapped(0.7)
    knobs = [sphere([x0 - 0.03, y0 + 0.36 + k * 0.402, 0.45], 0.018, 8) for k in range(3)]
    post = turned_leg([(0.015, 0.0), (0.028, 0.06), (0.024, 0.12)], 3, 8)
    feet = [post.moved([x, y, 0]) for x in (x0 + 0.06, x1 - 0.06) for y in (y0 + 0.07, y1 - 0.07)]
    outline = [(0.055, 0), (0.075, 0.03), (0.115, 0.13), (0.12, 0.2), (0.07, 0.3), (0.042, 0.35)]
    curve = spline([*outline, (0.05, 0.385), (0.066, 0.40)], 20)
    vase = revolve(np.concatenate([[[0, 0]], curve, curve[-1:] - [0.006, 0]]), 26)
    vase.uvs[:, 1] = 1 - vase.points[:, 2] / 0.40
    return {
        "sideboard": (merge(body), "lacquer"),
        "sideboard_top": (top, "lacquered_wood"),
        "sideboard_knobs": (merge(knobs), "brass"),
        "sideboard_feet": (merge(feet), "wood"),
        "vase": (vase.turned(20).moved([4.74, 1.78, 0.751]), "vase"),
        "chrome_ball": (sphere([4.74, 1.12, 0.871], 0.12, 26), "chrome"),
        "chrome_foot": (hoop(0.06, 0.01, 18, 5).moved([4.74, 1.12, 0.76]), "wood"),
    }


def tea() -> Shapes:
    """What stands on the table: a teapot, two cups, a mirror ball in a ring and a newspaper."""
    z = 0.7505
    body = [(0.05, 0), (0.085, 0.02), (0.108, 0.075), (0.09, 0.13), (0.055, 0.155)]
    pot = [turned_leg(body, 12, 26), turned_leg([(0.056, 0.154), (0.03, 0.175)], 3, 20)]
    pot += [sphere([0, 0, 0.185], 0.016, 10)]
    spout = [[0.08, 0, 0.055], [0.14, 0, 0.075], [0.155, 0, 0.125], [0.19, 0, 0.155]]
    pot += [tube(spout, [0.026, 0.018, 0.013, 0.011], 9, 10)]
    handle = [[-0.085, 0, 0.12], [-0.15, 0, 0.135], [-0.165, 0, 0.08], [-0.095, 0, 0.04]]
    pot += [tube(handle, [0.01], 11, 7)]
    teapot = merge(pot).turned(-65).moved([3.08, 2.10, z])
    cups = [cup().turned(a).moved([x, y, z]) for a, x, y in ((40, 2.88, 1.90), (200, 3.52, 2.28))]
    paper = quad([-0.21, -0.155, 0.003], [0.42, 0, 0], [0, 0.31, 0])
    ring = hoop(0.05, 0.008, 16, 5).moved([0, 0, 0.008])
    return {
        "teapot": (teapot, "red_glaze"),
        "cups": (merge(cups), "porcelain"),
        "mirror_ball": (sphere([3.60, 1.92, z + 0.098], 0.095, 28), "mirror"),
        "mirror_ball_ring": (ring.moved([3.60, 1.92, z]), "wood"),
        "newspaper": (paper.turned(-62).moved([3.18, 1.84, z]), "page"),
    }


def cup() -> Mesh:
    """A tea cup on its saucer."""
    wall = spline([(0.02, 0.012), (0.034, 0.03), (0.04, 0.065)], 5)
    inside = wall[::-1] - [0.003, -0.002]
    vessel = revolve(np.concatenate([wall, inside, [[0, inside[-1, 1]]]]), 15)
    plate = [[0, 0.001], [0.04, 0.002], [0.072, 0.014], [0.04, 0.009], [0, 0.009]]
    saucer = revolve(np.array(plate), 16)
    ear = [[0.036, 0, 0.055], [0.062, 0, 0.052], [0.058, 0, 0.028], [0.032, 0, 0.026]]
    return merge([vessel, saucer, tube(ear, [0.004], 7, 5)])


def lamp() -> Shapes:
    """The hanging lamp: the point light is free below its bulb and shade."""
    x, y, z = LAMP
    rim, top = z + 0.22, z + 0.40
    outer = np.array([[0.17, rim], [0.15, rim + 0.06], [0.09, rim + 0.14], [0.03, top]])
    outside = revolve(spline(outer, 6), 30)
    inside = revolve(spline(outer - [0.004, 0.002], 6), 30)
    cap = revolve(np.array([[0.034, top - 0.01], [0.03, top + 0.05], [0, top + 0.055]]), 20)
    cable = tube([[0, 0, top + 0.05], [0, 0, ROOM[2]]], [0.005], 2, 8)
    rose = revolve(np.array([[0, 2.665], [0.045, 2.67], [0.06, 2.699]]), 24)
    bulb = sphere([0, 0, z + 0.255], 0.045, 14)
    place = [x, y, 0]
    return {
        "lamp_shade": (outside.moved(place), "shade"),
        "lamp_lining": (inside.moved(place), "lining"),
        "lamp_fitting": (merge([cap, cable, rose]).moved(place), "brass"),
        "lamp_bulb": (bulb.moved(place), "bulb"),
    }


def pictures() -> Shapes:
    """Framed pictures, the clock, the eye chart and the wall mirror."""
    right, back, left = ROOM[0], ROOM[1], 0.0
    shapes: Shapes = {}
    frames: list[Mesh] = []

    def hang(name: str, bsdf: str, corner: Point, across: Point, height: float) -> None:
        up = np.array([0, 0, height])
        across = np.asarray(across, float)
        out = np.cross(across, up) / (np.linalg.norm(across) * height)
        corner = np.asarray(corner, float)
        shapes[name] = (quad(corner + 0.012 * out, across, up), bsdf)
        frames.append(frame(corner, across, up, out, 0.03))

    hang("picture_blocks", "blocks", [right, 3.80, 1.46], [0, -0.38, 0], 0.50)
    hang("picture_landscape", "landscape", [4.42, back, 1.46], [0.50, 0, 0], 0.375)
    hang("picture_rings", "rings", [left, 0.78, 1.32], [0, 0.72, 0], 0.54)
    hang("eye_chart", "eye_chart", [right, 2.09, 1.22], [0, -0.34, 0], 0.51)
    hang("wall_mirror", "mirror", [right, 1.62, 1.08], [0, -0.62, 0], 0.80)
    shapes["frames"] = (merge(frames).mapped(0.7), "wood")
    disc = revolve(np.array([[0.0, -0.02], [0.2, -0.02]]), 40).turned(180, "x")
    disc.uvs[:] = 0.5 + disc.points[:, [1, 0]] / 0.4 * [-1, -1]
    rim = hoop(0.2, 0.018, 30, 5).moved([0, 0, 0.02])
    at = [right, 2.14, 2.3]
    shapes["clock"] = (disc.turned(-90, "y").moved(at), "clock")
    shapes["clock_rim"] = (rim.turned(-90, "y").moved(at), "shade")
    return shapes


def frame(corner: np.ndarray, across: np.ndarray, up: np.ndarray, out: np.ndarray, wide: float) -> Mesh:
    """Four bars around a picture, 25 mm deep."""
    a, u = across / np.linalg.norm(across), up / np.linalg.norm(up)
    o, w, h = corner, np.linalg.norm(across), np.linalg.norm(up)
    bars = [
        (o - wide * (a + u), (w + 2 * wide) * a + wide * u),
        (o + h * u - wide * a, (w + 2 * wide) * a + wide * u),
        (o - wide * a, wide * a + h * u),
        (o + w * a, wide * a + h * u),
    ]
    ends = [(start, start + extent + 0.025 * out) for start, extent in bars]
    return merge(box(np.minimum(*pair), np.maximum(*pair)) for pair in ends)


def plant(rng: np.random.Generator) -> Shapes:
    """A pot plant with long, bent leaves."""
    pot = [(0.11, 0.0), (0.15, 0.16), (0.17, 0.30), (0.18, 0.33), (0.165, 0.34), (0.15, 0.31)]
    clay = np.concatenate([[[0, 0]], np.array(pot)])
    soil = revolve(np.array([[0.158, 0.30], [0, 0.315]]), 24)
    leaves: dict[bool, list[Mesh]] = {False: [], True: []}
    for k in range(34):
        turn = 137.5 * k + rng.uniform(-12, 12)
        length, lift = rng.uniform(0.5, 0.78), rng.uniform(0.3, 0.95) - 0.008 * k
        leaf = leaf_blade(length, 40 + 45 * lift, rng.uniform(0.035, 0.055)).turned(turn)
        leaves[k % 3 == 0].append(leaf.moved([0, 0, 0.31]))
    at = [4.55, 3.62, 0]
    return {
        "plant_pot": (revolve(clay, 24).moved(at), "clay"),
        "plant_soil": (soil.moved(at), "soil"),
        "plant_leaves": (merge(leaves[False]).moved(at), "leaf"),
        "plant_young_leaves": (merge(leaves[True]).moved(at), "young_leaf"),
    }


def leaf_blade(length: float, steep: float, width: float) -> Mesh:
    """A leaf that rises at ``steep`` degrees, bends over and is folded along its middle."""
    t = np.linspace(0, 1, 10)
    angle = np.radians(steep - 95 * t**1.6)
    step = length / 9
    x = np.concatenate([[0], np.cumsum(step * np.cos(angle[:-1]))])
    z = np.concatenate([[0], np.cumsum(step * np.sin(angle[:-1]))])
    half = width * np.sin(math.pi * np.clip(0.06 + 0.94 * t, 0, 1)) ** 0.8
    y = half[:, None] * np.array([-1, 0, 1])
    fold = 0.35 * np.abs(y)
    points = np.stack([np.broadcast_to(x[:, None], y.shape), y, z[:, None] + fold], -1)
    reach = np.hypot(x, 0).max()
    points[..., 0] *= min(1.0, 0.36 / reach)
    return grid(points)


def extras() -> Shapes:
    """A footstool near the sofa and the door behind the camera."""
    stool = turned_leg([(0.20, 0.06), (0.235, 0.10), (0.24, 0.22), (0.22, 0.33), (0.1, 0.365)], 9, 26)
    foot = turned_leg([(0.016, 0), (0.024, 0.07)], 2, 8)
    feet = [foot.moved([x, y, 0]) for x in (-0.12, 0.12) for y in (-0.12, 0.12)]
    at = [2.05, 2.72, 0]
    panel = [box([0.0, 1.75, 0], [0.03, 2.6, 2.05])]
    panel += [box([0.0, y, 0], [0.045, y + 0.07, 2.12]) for y in (1.68, 2.6)]
    panel += [box([0.0, 1.75, 2.05], [0.045, 2.6, 2.12])]
    for z in (0.2, 1.1):
        panel += [box([0.03, y, z], [0.042, y + 0.3, z + 0.78]) for y in (1.83, 2.22)]
    return {
        "footstool": (stool.moved(at), "mustard"),
        "footstool_feet": (merge(feet).moved(at), "wood"),
        "door": (merge(panel), "door_paint"),
        "door_knob": (sphere([0.08, 1.81, 1.0], 0.035, 12), "brass"),
    }


def room_shapes() -> Shapes:
    """Everything in the room and outside of it."""
    shelf_rng, plant_rng = np.random.default_rng(SEED + 1).spawn(2)
    parts = [shell(), window(), backdrop(), table(), chairs(), sofa(), bookshelf(shelf_rng)]
    parts += [sideboard(), tea(), lamp(), pictures(), plant(plant_rng), extras()]
    return {name: shape for part in parts for name, shape in part.items()}


# ---------------------------------------------------------------------------------------------
# Scene files
# ---------------------------------------------------------------------------------------------

HEAD = """<scene version="3.0.0">
\t<default name="integrator" value="path" />
\t<default name="spp" value="64" />
\t<default name="resy" value="{size}" />
\t<default name="resx" value="{size}" />
\t<default name="max_depth" value="{depth}" />
\t<default name="rr_depth" value="{depth}" />
\t<integrator type="$integrator">
\t\t<integer name="max_depth" value="$max_depth" />
\t\t<integer name="rr_depth" value="$rr_depth" />
\t</integrator>
\t<sensor type="perspective" id="camera">
\t\t<string name="fov_axis" value="y" />
\t\t<float name="fov" value="{fov}" />
\t\t<float name="near_clip" value="0.02" />
\t\t<float name="far_clip" value="10000" />
\t\t<transform name="to_world">
\t\t\t<lookat origin="{origin}" target="{target}" up="{up}" />
\t\t</transform>
\t\t<sampler type="independent">
\t\t\t<integer name="sample_count" value="$spp" />
\t\t</sampler>
\t\t<film type="hdrfilm">
\t\t\t<integer name="width" value="$resx" />
\t\t\t<integer name="height" value="$resy" />
\t\t\t<string name="file_format" value="openexr" />
\t\t\t<string name="pixel_format" value="rgb" />
\t\t\t<rfilter type="box" />
\t\t</film>
\t</sensor>
"""


def row(values: Iterable[float]) -> str:
    """Numbers as Mitsuba's XML wants them."""
    return ", ".join(f"{v:g}" for v in values)


def head(size: int, depth: int, fov: float, view: tuple[Point, Point, Point], far: float = 100) -> str:
    """The beginning of a scene file; ``view`` is origin, target and up, ``far`` the end of sight."""
    origin, target, up = (row(v) for v in view)
    return HEAD.format(size=size, depth=depth, fov=fov, far=row([far]), origin=origin, target=target, up=up)


def colour(name: str, value: float | Point | str) -> str:
    """A reflectance: one number, three, or the file of a texture."""
    if isinstance(value, str):
        return (
            f'\t\t\t<texture name="{name}" type="bitmap">\n'
            f'\t\t\t\t<string name="filename" value="textures/{value}" />\n'
            '\t\t\t\t<string name="filter_type" value="bilinear" />\n'
            "\t\t\t</texture>\n"
        )
    values = (value,) * 3 if isinstance(value, float) else value
    return f'\t\t\t<rgb name="{name}" value="{row(values)}" />\n'


def bsdf(name: str, kind: str, body: str) -> str:
    """A two-sided material."""
    return f'\t<bsdf type="twosided" id="{name}">\n\t\t<bsdf type="{kind}">\n{body}\t\t</bsdf>\n\t</bsdf>\n'


def plastic(value: Point | str, alpha: float) -> str:
    """The inside of a rough plastic."""
    return (
        colour("diffuse_reflectance", value)
        + '\t\t\t<string name="distribution" value="ggx" />\n'
        + f'\t\t\t<float name="alpha" value="{alpha}" />\n'
        + '\t\t\t<float name="int_ior" value="1.5" />\n'
        + '\t\t\t<boolean name="nonlinear" value="true" />\n'
    )


def metal(eta: Point, k: Point, alpha: float) -> str:
    """The inside of a rough metal with the refractive index ``eta`` + i ``k``."""
    return (
        f'\t\t\t<rgb name="eta" value="{row(eta)}" />\n'
        f'\t\t\t<rgb name="k" value="{row(k)}" />\n'
        '\t\t\t<string name="distribution" value="ggx" />\n'
        f'\t\t\t<float name="alpha" value="{alpha}" />\n'
    )


def mirror(reflectance: float) -> str:
    """The inside of a perfect mirror."""
    none = '\t\t\t<string name="material" value="none" />\n'
    return none + colour("specular_reflectance", reflectance)


# Pictures that materials are named after.
PICTURES = (
    "floor.jpg", "wallpaper.jpg", "wood.jpg", "rug.jpg", "books.jpg", "fabric.jpg", "stripes.png",
    "landscape.jpg", "blocks.png", "rings.jpg", "eye_chart.png", "clock.png", "page.png", "globe.jpg",
    "outdoors.jpg",
)  # fmt: skip
DIFFUSE: dict[str, float | Point | str] = {
    **{Path(file).stem: file for file in PICTURES},
    "plaster": 0.82,
    "white_paint": (0.78, 0.77, 0.74),
    "door_paint": (0.34, 0.46, 0.46),
    "curtain": (0.62, 0.30, 0.20),
    "rug_hem": (0.28, 0.08, 0.07),
    "mustard": (0.66, 0.44, 0.12),
    "clay": (0.52, 0.24, 0.15),
    "soil": (0.10, 0.07, 0.05),
    "leaf": (0.11, 0.27, 0.09),
    "young_leaf": (0.24, 0.42, 0.12),
    "lining": 0.1,
    "bulb": 0.4,
}


def room_bsdfs() -> str:
    """All materials of the room."""
    parts = [bsdf(name, "diffuse", colour("reflectance", v)) for name, v in DIFFUSE.items()]
    parts += [
        bsdf("lacquered_wood", "roughplastic", plastic("wood.jpg", 0.2)),
        bsdf("lacquer", "roughplastic", plastic((0.05, 0.19, 0.21), 0.15)),
        bsdf("red_glaze", "roughplastic", plastic((0.48, 0.06, 0.04), 0.1)),
        bsdf("green_glaze", "roughplastic", plastic((0.08, 0.34, 0.20), 0.1)),
        bsdf("porcelain", "roughplastic", plastic((0.74, 0.73, 0.70), 0.12)),
        bsdf("vase", "roughplastic", plastic("vase.jpg", 0.1)),
        bsdf("shade", "roughplastic", plastic((0.06, 0.16, 0.13), 0.2)),
        bsdf("chrome", "roughconductor", metal((4.37, 2.92, 1.65), (5.21, 4.23, 3.75), 0.12)),
        bsdf("brass", "roughconductor", metal((0.444, 0.527, 1.094), (3.695, 2.765, 1.829), 0.25)),
        bsdf("gold", "roughconductor", metal((0.143, 0.375, 1.442), (3.983, 2.386, 1.603), 0.2)),
        bsdf("mirror", "conductor", mirror(0.92)),
    ]
    return "".join(parts)


def room_lights() -> str:
    """The sun and the lamp."""
    return (
        '\t<emitter type="directional" id="sun">\n'
        f'\t\t<vector name="direction" value="{row(SUN_DIRECTION)}" />\n'
        '\t\t<rgb name="irradiance" value="15, 13.8, 11.6" />\n\t</emitter>\n'
        '\t<emitter type="point" id="lamp">\n'
        f'\t\t<point name="position" value="{row(LAMP)}" />\n'
        '\t\t<rgb name="intensity" value="6.2, 5.6, 4.7" />\n\t</emitter>\n'
    )


def write_shapes(folder: Path, shapes: Shapes) -> tuple[str, int]:
    """Write meshes; their part of the scene file, and the number of their triangles."""
    text, triangles = "", 0
    for name, (mesh, material) in shapes.items():
        triangles += write_ply(folder / "meshes" / f"{name}.ply", mesh)
        text += ply_shape(name, material)
    return text, triangles


def ply_shape(name: str, material: str, folder: str = "") -> str:
    """A mesh in a scene's folder, or in another one."""
    return (
        f'\t<shape type="ply" id="{name}_shape">\n'
        f'\t\t<string name="filename" value="{folder}meshes/{name}.ply" />\n'
        f'\t\t<ref id="{material}" />\n\t</shape>\n'
    )


def write_textures(folder: Path, pictures: dict[str, Image.Image]) -> None:
    """Make the folders of a scene and write its pictures."""
    for name in ("meshes", "textures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, picture in pictures.items():
        options = {"quality": 90} if name.endswith("jpg") else {"optimize": True}
        picture.save(folder / "textures" / name, **options)


def write_room(folder: Path) -> int:
    """Write the room; the number of its triangles."""
    write_textures(folder, textures())
    shapes, triangles = write_shapes(folder, room_shapes())
    text = head(512, 6, 60, (CAMERA, TARGET, (0, 0, 1))) + room_bsdfs() + shapes + room_lights()
    (folder / "room.xml").write_text(text + "</scene>\n", encoding="utf-8")
    return triangles


Builtin = tuple[str, str, Sequence[str]]
CORNELL: dict[str, Builtin] = {
    # name: (kind, material, transform); a rectangle is one of -1..1 that faces +z
    "floor": ("rectangle", "white", ("rotate x -90", "translate 0 -1 0")),
    "ceiling": ("rectangle", "white", ("rotate x 90", "translate 0 1 0")),
    "back": ("rectangle", "white", ("translate 0 0 -1",)),
    "left": ("rectangle", "red", ("rotate y 90", "translate -1 0 0")),
    "right": ("rectangle", "green", ("rotate y -90", "translate 1 0 0")),
    "tall_box": ("cube", "white", ("scale 0.3 0.6 0.3", "rotate y 17", "translate -0.34 -0.4 -0.3")),
    "small_box": ("cube", "satin", ("scale 0.3 0.3 0.3", "rotate y -17", "translate 0.35 -0.7 0.36")),
}


def transform(steps: Sequence[str]) -> str:
    """The XML of a transformation written as "translate x y z", "scale x y z", "rotate axis a"."""
    lines = []
    for step in steps:
        kind, *values = step.split()
        if kind == "rotate":
            lines.append(f'<rotate {values[0]}="1" angle="{values[1]}" />')
        else:
            lines.append(f'<{kind} value="{", ".join(values)}" />')
    body = "".join(f"\t\t\t{line}\n" for line in lines)
    return f'\t\t<transform name="to_world">\n{body}\t\t</transform>\n'


def builtin_shapes(shapes: dict[str, Builtin], more: str = "") -> str:
    """Builtin shapes of Mitsuba, each with more inside."""
    return "".join(
        f'\t<shape type="{kind}" id="{name}">\n{transform(steps)}'
        f'\t\t<ref id="{material}" />\n{more}\t</shape>\n'
        for name, (kind, material, steps) in shapes.items()
    )


def write_cornell(folder: Path) -> None:
    """Write the Cornell box: y points up, the walls stand at -1 and 1."""
    folder.mkdir(parents=True, exist_ok=True)
    colours = {"white": (0.73, 0.73, 0.72), "red": (0.57, 0.05, 0.04), "green": (0.12, 0.42, 0.08)}
    text = head(256, 6, 38, ((0, 0, 3.9), (0, 0, 0), (0, 1, 0)))
    text += "".join(bsdf(n, "diffuse", colour("reflectance", c)) for n, c in colours.items())
    text += bsdf("satin", "roughplastic", plastic((0.62, 0.64, 0.70), 0.2))
    text += builtin_shapes(CORNELL)
    light = '\t\t<emitter type="area">\n\t\t\t<rgb name="radiance" value="30, 26, 18" />\n\t\t</emitter>\n'
    steps = ("scale 0.23 0.19 1", "rotate x 90", "translate 0 0.99 0.01")
    text += builtin_shapes({"light": ("rectangle", "white", steps)}, light)
    (folder / "cornell.xml").write_text(text + "</scene>\n", encoding="utf-8")


# ---------------------------------------------------------------------------------------------
# Meadow: x points to the right, y ahead, the camera stands at the origin
# ---------------------------------------------------------------------------------------------

HORIZON = 4000.0
SUN_AZIMUTH, SUN_ELEVATION = math.radians(-75), math.radians(34)
POND, POND_RADIUS = np.array([-3.4, 8.2]), 2.1


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the ground: flat near the camera, hills far away."""
    distance = np.hypot(x, y)
    away = np.clip((distance - 14) / 60, 0, 1)
    waves = 1.4 * np.sin(x / 23 + 1) * np.sin(y / 19) + 0.8 * np.sin(x / 11 - y / 17)
    hills = 26 * np.sin(x / 310 + 2) * np.sin(y / 270) + 14 * np.sin(x / 130 + y / 190)
    rise = np.clip((distance - 150) / 900, 0, 1.6)
    return away * waves + rise * (hills + 22)


def raised(x: float, y: float) -> list[float]:
    """The place on the ground at x, y."""
    return [x, y, float(height(np.array(x), np.array(y)))]


def ground() -> Shapes:
    """The ground in rings that widen with the distance; farther away it is fields and woods."""
    radius = np.concatenate([[0], np.geomspace(1.2, HORIZON, 46)])
    angle = np.linspace(0, 2 * math.pi, 97)
    x, y = np.outer(radius, np.sin(angle)), np.outer(radius, np.cos(angle))
    basin = np.hypot(x - POND[0], y - POND[1])
    z = height(x, y) - 0.35 * np.clip(1.25 - basin / POND_RADIUS, 0, 0.4)
    mesh = grid(np.stack([x, y, z], -1)[:, ::-1])
    centre = mesh.points[mesh.faces].mean(axis=1)
    distance = np.hypot(centre[:, 0], centre[:, 1])
    patch = np.sin(centre[:, 0] / (60 + distance / 9)) + np.sin(centre[:, 1] / (45 + distance / 11) + 1)
    kind = np.where(patch > 0.7, 2, np.where(patch < -0.75, 3, 1))
    kind[distance < 55] = 0
    tiles = {"meadow": 4.0, "pasture": 90.0, "wheat": 60.0, "woods": 120.0}
    shapes: Shapes = {}
    for number, (name, tile) in enumerate(tiles.items()):
        part = Mesh(mesh.points, mesh.uvs, mesh.faces[kind == number])
        shapes[f"ground_{name}"] = part.mapped(tile), name
    return shapes


def blob(rng: np.random.Generator, radius: float, squash: float, segments: int) -> Mesh:
    """A ball with dents, as stones and the crowns of trees are."""
    ball = sphere([0, 0, 0], 1, segments)
    way = rng.uniform(-1, 1, (5, 3))
    dents = sum(np.sin(3 * ball.points @ w + k) for k, w in enumerate(way)) / 5
    return Mesh(ball.points * (radius * (1 + 0.35 * dents))[:, None] * [1, 1, squash], ball.uvs, ball.faces)


def tree(rng: np.random.Generator, at: Point, tall: float, segments: int) -> tuple[Mesh, Mesh]:
    """Trunk and crown of a tree that is `tall` metres high."""
    lean = rng.uniform(-0.05, 0.05, 2) * tall
    knots = [(0, 0, -0.3), (0.3 * lean[0], 0, 0.3 * tall), (*lean, 0.75 * tall)]
    trunk = tube(knots, [0.035 * tall, 0.02 * tall, 0.008 * tall], 6, max(5, segments // 2))
    crown = [blob(rng, 0.25 * tall, 0.9, segments).moved([*lean, 0.68 * tall])]
    for turn in rng.uniform(0, 60) + np.arange(0, 360, 90):
        out = [0.2 * tall * math.cos(math.radians(turn)), 0.2 * tall * math.sin(math.radians(turn))]
        part = blob(rng, rng.uniform(0.15, 0.2) * tall, 0.85, segments)
        crown.append(part.moved([*(lean + out), rng.uniform(0.48, 0.66) * tall]))
    return trunk.moved(at), merge(crown).moved(at)


def trees(rng: np.random.Generator) -> Shapes:
    """A few trees near the camera and many far ones, all around."""
    places = [(-8.5, 15, 7.5), (8.2, 9.5, 5.2), (-2.5, 27, 8.5), (13, 21, 9), (-16, -9, 8), (9, -12, 7)]
    near = [tree(rng, raised(x, y), tall, 12) for x, y, tall in places]
    far = []
    for _ in range(45):
        distance, turn = 40 * 25 ** rng.uniform(), rng.uniform(0, 2 * math.pi)
        x, y = distance * math.sin(turn), distance * math.cos(turn)
        far.append(tree(rng, raised(x, y), rng.uniform(6, 12), 6))
    every = near + far
    crowns = [crown for _, crown in every]
    return {
        "trunks": (merge([trunk for trunk, _ in every]), "bark"),
        "crowns": (merge(crowns[::2]).mapped(1.2), "leaves"),
        "crowns_of_olive": (merge(crowns[1::2]).mapped(1.2), "olive"),
    }


def hut() -> Shapes:
    """A wooden hut with a red roof, a door, and windows in which the sky shows."""
    walls, roof = box([-2, 0, -0.2], [2, 3, 2.3]), []
    for side in (-1, 1):
        corner = [2.3 * side, -0.35, 2.1]
        eaves, slope = [0, 3.7 * side, 0], [-2.3 * side, 0, 1.5]
        roof += [quad(corner if side > 0 else [-2.3, 3.35, 2.1], eaves, slope)]
    gables = [
        Mesh(
            np.array([[-2, y, 2.3], [2, y, 2.3], [0, y, 3.6]], float), np.zeros((3, 2)), np.array([[0, 1, 2]])
        )
        for y in (0.0, 3.0)
    ]
    door = box([-1.5, -0.06, 0], [-0.6, 0, 1.95])
    panes = merge([quad([x, -0.05, 0.95], [0.75, 0, 0], [0, 0, 0.85]) for x in (0.0, 1.05)])
    frames = []
    for x in (0.0, 1.05):
        frames += [box([x - 0.06, -0.09, z], [x + 0.81, 0, z + 0.06]) for z in (0.89, 1.8)]
        frames += [box([x + dx, -0.09, 0.95], [x + dx + 0.06, 0, 1.8]) for dx in (-0.06, 0.345, 0.75)]
    place = lambda mesh: mesh.turned(-14).moved([3.4, 13.5, 0])  # noqa: E731
    return {
        "hut_walls": (place(merge([walls, *gables]).mapped(1.4)), "planks"),
        "hut_roof": (place(merge(roof).mapped(2.0)), "tiles"),
        "hut_door": (place(door), "green_paint"),
        "hut_frames": (place(merge(frames)), "white_paint"),
        "hut_panes": (place(panes), "window"),
    }


def by_the_water(rng: np.random.Generator) -> Shapes:
    """The pond, stones around it, and a fence."""
    turn = np.linspace(0, 2 * math.pi, 41)
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1) * POND_RADIUS
    water = grid(np.stack([rim * 0, rim])).moved([*POND, -0.05])
    stones = []
    for angle in np.linspace(0, 2 * math.pi, 15)[:-1] + rng.uniform(-0.15, 0.15, 14):
        out = POND + POND_RADIUS * rng.uniform(1.0, 1.2) * np.array([math.cos(angle), math.sin(angle)])
        stones.append(blob(rng, rng.uniform(0.12, 0.32), 0.6, 12).moved([*out, 0.02]))
    posts, rails = [], []
    line = [np.array([1.3 + 1.9 * k, 5.2 + 0.75 * k]) for k in range(9)]
    for x, y in line:
        posts.append(turned_leg([(0.06, -0.3), (0.055, 0.6), (0.05, 1.1)], 3, 8).moved(raised(x, y)))
    for (x, y), (u, v) in itertools.pairwise(line):
        for z in (0.45, 0.85):
            start, end = np.array(raised(x, y)), np.array(raised(u, v))
            rise = np.array([0, 0, z])
            knots = [start + rise, (start + end) / 2 + 0.96 * rise, end + rise]
            rails.append(tube(knots, [0.03, 0.03], 3, 6))
    return {
        "pond": (water, "water"),
        "stones": (merge(stones).mapped(0.8), "stone"),
        "fence": (merge([*posts, *rails]), "weathered"),
    }


def ground_picture(
    rng: np.random.Generator, size: int, tone: Colour, spread: float, cells: tuple[int, ...]
) -> Image.Image:
    """A tile of ground: noise of several sizes on one colour; it repeats in both directions."""
    total = np.zeros((size, size))
    for count in cells:
        coarse = rng.uniform(-1, 1, (count, count)).astype(np.float32)
        repeated = Image.fromarray(np.tile(coarse, (3, 3)), mode=None)
        smooth = repeated.resize((3 * size,) * 2, Image.Resampling.BICUBIC)
        total += np.asarray(smooth)[size:-size, size:-size]
    tint = np.array([0.9, 1.0, 0.7]) if tone[1] > tone[0] else np.ones(3)
    return to_image(np.array(tone) * (1 + spread * total[..., None] / len(cells) ** 0.5 * tint))


def tiles_picture() -> Image.Image:
    """Rows of red tiles."""
    y, x = np.mgrid[0:256, 0:256]
    shade = 0.65 + 0.35 * (y % 32) / 32
    shade *= np.where((x + 16 * (y // 32)) % 32 < 2, 0.7, 1.0)
    return to_image(shade[..., None] * np.array([176, 84, 60]))


def planks_picture(rng: np.random.Generator) -> Image.Image:
    """Upright planks."""
    x = np.arange(256)
    tone = rng.uniform(0.8, 1.1, 8)[x // 32] * np.where(x % 32 < 2, 0.5, 1.0)
    grain = 1 + 0.12 * noise(rng, (256, 256), (90, 6))
    return to_image((tone * grain)[..., None] * np.array([150, 112, 78]))


def meadow_textures(rng: np.random.Generator) -> dict[str, Image.Image]:
    """Every picture of the meadow but its sky."""
    return {
        "meadow.jpg": ground_picture(rng, 512, (98, 112, 62), 0.26, (5, 13, 60, 170)),
        "pasture.jpg": ground_picture(rng, 256, (112, 126, 76), 0.14, (4, 9, 40)),
        "wheat.jpg": ground_picture(rng, 256, (196, 168, 92), 0.12, (3, 30)),
        "woods.jpg": ground_picture(rng, 256, (58, 84, 48), 0.3, (20, 60)),
        "leaves.jpg": ground_picture(rng, 256, (76, 112, 44), 0.35, (9, 31, 64)),
        "olive.jpg": ground_picture(rng, 256, (118, 122, 56), 0.3, (9, 31, 64)),
        "stone.jpg": ground_picture(rng, 128, (150, 146, 138), 0.2, (4, 11, 33)),
        "planks.jpg": planks_picture(rng),
        "tiles.jpg": tiles_picture(),
    }


def sky_radiance(rng: np.random.Generator, width: int = 512) -> np.ndarray:
    """(height, width, 3) the sky with clouds and the sun; the azimuth runs from ahead to the right."""
    azimuth = 2 * math.pi * (np.arange(width) + 0.5) / width
    polar = math.pi * (np.arange(width // 2) + 0.5) / (width // 2)
    x, y = np.outer(np.sin(polar), np.sin(azimuth)), np.outer(np.sin(polar), np.cos(azimuth))
    z = np.broadcast_to(np.cos(polar)[:, None], x.shape)
    high = np.clip(z, 0, 1)[..., None] ** 0.5
    sky = (1 - high) * np.array([0.62, 0.72, 0.84]) + high * np.array([0.12, 0.27, 0.62])
    away = np.stack([x, y], -1) / (np.abs(z)[..., None] + 0.14)
    cloud = np.zeros(x.shape)
    for cells, share in ((22, 0.62), (48, 0.36), (110, 0.2)):
        picture = noise(rng, (1024, 1024), (cells, cells))
        column, line = ((away[..., k] / 14.4 + 0.5) * 1023 for k in range(2))
        cloud += share * picture[line.astype(int), column.astype(int)]
    cover = np.clip(2.1 * cloud - 0.12, 0, 1)[..., None] * np.clip(9 * z, 0, 1)[..., None]
    sun = [math.sin(SUN_AZIMUTH), math.cos(SUN_AZIMUTH)]
    toward = math.cos(SUN_ELEVATION) * (x * sun[0] + y * sun[1]) + math.sin(SUN_ELEVATION) * z
    glow = 0.35 * np.exp(-(1 - toward) / 0.02)[..., None] * np.array([1.0, 0.9, 0.7])
    lit = 0.8 + 0.25 * np.clip(toward, 0, 1)[..., None]
    sky = (1 - cover) * sky + cover * lit * np.array([1.0, 0.99, 0.97]) + glow
    column = SUN_AZIMUTH % (2 * math.pi) / (2 * math.pi) * width
    line = (0.5 - SUN_ELEVATION / math.pi) * width / 2
    rows, columns = np.s_[round(line) - 1 : round(line) + 1], np.s_[round(column) - 1 : round(column) + 1]
    # Four texels give the irradiance of the sun.
    solid_angle = 4 * (2 * math.pi / width) ** 2 * math.cos(SUN_ELEVATION)
    sky[rows, columns] += np.array([9.0, 8.2, 6.6]) / solid_angle
    return np.where(z[..., None] < 0, [0.2, 0.21, 0.18], sky)


def write_sky(path: Path, radiance: np.ndarray) -> None:
    """Write radiance as an EXR file of half floats."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": radiance.astype(np.float16)}) as file:
        file.write(str(path))


MEADOW_DIFFUSE: dict[str, float | Point | str] = {
    **{name: f"{name}.jpg" for name in ("meadow", "pasture", "wheat", "woods", "leaves", "olive")},
    **{name: f"{name}.jpg" for name in ("stone", "planks", "tiles")},
    "bark": (0.17, 0.12, 0.08),
    "weathered": (0.42, 0.38, 0.32),
    "white_paint": (0.78, 0.77, 0.74),
    "green_paint": (0.12, 0.26, 0.18),
}


def write_meadow(folder: Path) -> int:
    """Write the meadow; the number of its triangles."""
    pictures, plants, water, sky = np.random.default_rng(SEED + 2).spawn(4)
    write_textures(folder, meadow_textures(pictures))
    write_sky(folder / "textures" / "sky.exr", sky_radiance(sky))
    text = head(512, 6, 50, ((0, 0, 1.65), (0.6, 10, 1.75), (0, 0, 1)), far=2 * HORIZON)
    text += "".join(bsdf(name, "diffuse", colour("reflectance", v)) for name, v in MEADOW_DIFFUSE.items())
    text += bsdf("window", "conductor", mirror(0.35)) + bsdf("water", "conductor", mirror(0.5))
    shapes, triangles = write_shapes(folder, {**ground(), **trees(plants), **hut(), **by_the_water(water)})
    emitter = (
        '\t<emitter type="envmap" id="sky">\n\t\t<string name="filename" value="textures/sky.exr" />\n'
        '\t\t<transform name="to_world">\n\t\t\t<rotate x="1" angle="90" />\n\t\t</transform>\n\t</emitter>\n'
    )
    (folder / "meadow.xml").write_text(text + shapes + emitter + "</scene>\n", encoding="utf-8")
    return triangles


def main() -> None:
    """Write all scenes."""
    triangles = {"room": write_room(HERE / "room"), "meadow": write_meadow(HERE / "meadow")}
    write_cornell(HERE / "cornell")
    for name, count in triangles.items():
        print(f"{name}: {count} triangles")


if __name__ == "__main__":
    main()
