"""Data sets of COLMAP: read from texts and binary files, and written from frame sets."""

from __future__ import annotations

import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError
from compose.camera.camera import Camera, camera_from_pose
from compose.camera.coordinate_systems import camera_to_json
from compose.image.colour import bytes_from_radiance
from pathtrace.dataset.captured_frames import CapturedFrame, read_frame, write_frame
from pathtrace.dataset.colmap_layout import model_of, read_colmap, write_colmap
from pathtrace.dataset.colmap_model import (
    MODELS,
    ColmapModel,
    ModelCamera,
    ModelImage,
    ModelPoints,
    read_model,
    write_model,
)
from pathtrace.dataset.frame_set import FORMAT_VERSION, FrameSet, read_frame_set
from pathtrace.dataset.posed_images import Lens, read_pixels
from pathtrace.dataset.posed_layouts import is_posed_folder, read_posed_folder
from tests import posed
from tests.conftest import real_file
from tests.extremes import extreme

NAMES = [f"view {number:02d}.png" for number in range(10)]


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "."])
def test_images_and_cameras_are_those_of_the_model(tmp_path, place):
    folder = posed.write_colmap(tmp_path / "ball", place=place)
    assert is_posed_folder(folder)
    # Smaller copies are left alone.
    (folder / "images_2").mkdir()
    found = read_posed_folder(folder)
    assert (found.layout, found.scene_name, found.moves) == ("COLMAP", "ball", False)
    assert [image.file.name for image in found.images] == NAMES
    assert [image.file.name for image in found.held_out] == [NAMES[0], NAMES[8]]
    for number, image in enumerate(found.images):
        expected = posed.camera(number, posed.WIDTH >> number % 2, posed.HEIGHT >> number % 2)
        assert np.allclose(image.camera.world_to_camera, expected.world_to_camera, atol=1e-12)
        assert replace(image.camera, world_to_camera=expected.world_to_camera) == expected
        assert image.lens is None
        _, _, colour = posed.cast(expected, 0.0)
        assert np.array_equal(bytes_from_radiance(read_pixels(image).radiance), posed._bytes(colour))
    assert found.points is not None
    ball = np.linalg.norm(found.points - posed.ball_centre(0.0), axis=1)
    assert np.minimum(np.abs(ball - posed.RADIUS), np.abs(found.points[:, 2] - posed.WALL)).max() < 1e-9


def test_a_model_may_have_no_points_and_say_what_is_held_out(tmp_path):
    folder = posed.write_colmap(tmp_path / "a", 4)
    (folder / "sparse/0/points3D.txt").unlink()
    (folder / "sparse/0/test.txt").write_text("view 02.png\nelsewhere.png\n")
    found = read_posed_folder(folder)
    assert [image.held_out for image in found.images] == [False, False, True, False]
    assert found.points is not None
    assert found.points.shape == (0, 3)


LENSES = {
    "SIMPLE_RADIAL": ([0.1], Lens((0.1, 0, 0))),
    "RADIAL": ([0.1, 0.2], Lens((0.1, 0.2, 0))),
    "OPENCV": ([0.1, 0.2, 0.3, 0.4], Lens((0.1, 0.2, 0), (0.3, 0.4))),
    "FULL_OPENCV": (
        [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8],
        Lens((0.1, 0.2, 0.5), (0.3, 0.4), divisor=(0.6, 0.7, 0.8)),
    ),
}


@pytest.mark.parametrize("model", LENSES)
def test_lenses_are_those_of_the_model_at_the_size_of_the_image(tmp_path, model):
    coefficients, lens = LENSES[model]
    folder = posed.write_colmap(tmp_path / "a", 1)
    focal = [90.0] if model in ("SIMPLE_RADIAL", "RADIAL") else [90.0, 80.0]
    numbers = " ".join(map(str, [posed.WIDTH * 2, posed.HEIGHT * 2, *focal, 50.0, 30.0, *coefficients]))
    (folder / "sparse/0/cameras.txt").write_text(f"7 {model} {numbers}\n")
    (image,) = read_posed_folder(folder).images
    camera = image.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (45.0, focal[-1] / 2, 25.0, 15.0)
    assert image.lens == lens


def test_the_rational_lens_is_that_of_opencv():
    x, y, r2 = 0.3, -0.2, 0.13
    lens = Lens((0.1, 0.02, -0.03), (0.01, -0.02), divisor=(0.2, -0.1, 0.05))
    radial = (1 + 0.1 * r2 + 0.02 * r2**2 - 0.03 * r2**3) / (1 + 0.2 * r2 - 0.1 * r2**2 + 0.05 * r2**3)
    across, down = lens.distorted(np.array([x]), np.array([y]))
    assert across[0] == pytest.approx(x * radial + 2 * 0.01 * x * y - 0.02 * (r2 + 2 * x * x))
    assert down[0] == pytest.approx(y * radial + 0.01 * (r2 + 2 * y * y) - 2 * 0.02 * x * y)


def binary(folder: Path) -> Path:
    """The same data set with a binary model, written by the format's description."""
    place = folder / "sparse/0"
    lines = {name: (place / f"{name}.txt").read_text().split("\n") for name in ("cameras", "images")}
    rows = [line.split() for line in lines["cameras"][1:-1]]
    content = struct.pack("<Q", len(rows))
    for number, model, width, height, *numbers in rows:
        identity = list(MODELS).index(model)
        content += struct.pack(
            f"<IiQQ{len(numbers)}d", int(number), identity, int(width), int(height), *map(float, numbers)
        )
    (place / "cameras.bin").write_bytes(content)
    shots = [line.split(maxsplit=9) for line in lines["images"][1:-1:2]]
    content = struct.pack("<Q", len(shots))
    for number, *pose, camera, name in shots:
        content += struct.pack("<I7dI", int(number), *map(float, pose), int(camera)) + name.encode() + b"\0"
        content += struct.pack("<QddqddQ", 2, 1.5, 2.5, 1, 3.5, 4.5, 2**64 - 1)
    (place / "images.bin").write_bytes(content)
    content = struct.pack("<Q", 2)
    for number in range(2):
        content += struct.pack("<Q3d3BdQ4I", number, 0.1, number, 2, 9, 8, 7, 0.5, 2, 1, 0, 2, 0)
    (place / "points3D.bin").write_bytes(content)
    for file in place.glob("*.txt"):
        file.unlink()
    return folder


def test_binary_models_are_read_as_texts_are(tmp_path):
    text = read_posed_folder(posed.write_colmap(tmp_path / "a"))
    found = read_posed_folder(binary(posed.write_colmap(tmp_path / "b")))
    assert [image.camera for image in found.images] == [image.camera for image in text.images]
    assert np.array_equal(found.points, [[0.1, 0, 2], [0.1, 1, 2]])
    assert found.scene_hash == text.scene_hash


def test_binary_files_come_before_texts(tmp_path):
    folder = binary(posed.write_colmap(tmp_path / "a"))
    for name in ("cameras", "images"):
        (folder / f"sparse/0/{name}.txt").write_text("")
    assert len(read_posed_folder(folder).images) == 10


REFUSED = {
    "a missing image": (
        lambda f: (f / "images/view 01.png").unlink(),
        r"1 of 10 images are missing: view 01.png$",
    ),
    "no images": (
        lambda f: shutil.rmtree(f / "images"),
        r"10 of 10 images are missing: view 00.png, view 01.png, view 02.png, \.\.\.$",
    ),
    "a lens that sees all around": (
        lambda f: (f / "sparse/0/cameras.txt").write_text("7 OPENCV_FISHEYE 48 32 45 45 24 16 0 0 0 0\n"),
        r"view 00.png: its camera is of model OPENCV_FISHEYE; must be one of .*undistort the images first",
    ),
    "an unknown model": (
        lambda f: (f / "sparse/0/cameras.txt").write_text("7 MAGIC 48 32 45\n"),
        r"cameras.txt: not a file of a COLMAP model \(camera 7 is of model MAGIC",
    ),
    "a missing camera": (
        lambda f: (f / "sparse/0/cameras.txt").write_text("7 PINHOLE 48 32 45 45 24 16\n"),
        "view 01.png has camera 8, which is missing",
    ),
    "an image of another shape": (
        lambda f: Image.new("RGB", (48, 48)).save(f / "images/view 00.png"),
        "view 00.png: has 48 x 48 pixels; its camera has 48 x 32, of another shape",
    ),
    "no focal length": (
        lambda f: (f / "sparse/0/cameras.txt").write_text("7 PINHOLE 48 32 0 45 24 16\n"),
        "view 00.png: camera has .* a focal length that is not positive",
    ),
    "a name outside": (
        lambda f: (f / "sparse/0/images.txt").write_text("1 1 0 0 0 0 0 0 7 ../a.png\n\n"),
        "is not the name of a file in the folder",
    ),
    "no rotation": (
        lambda f: (f / "sparse/0/images.txt").write_text("1 0 0 0 0 0 0 0 7 a.png\n\n"),
        "images.txt: not a file of a COLMAP model",
    ),
    "an endless point": (
        lambda f: (f / "sparse/0/points3D.txt").write_text("1 inf 0 0 0 0 0 0\n"),
        r"points3D.txt: not a file of a COLMAP model \(holds a point that is not finite\)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_makes_no_data_set_is_refused_in_one_line(tmp_path, name):
    spoil, message = REFUSED[name]
    folder = posed.write_colmap(tmp_path / "a")
    spoil(folder)
    with pytest.raises(UserError, match=message) as refused:
        read_posed_folder(folder)
    assert "\n" not in str(refused.value)


@extreme(
    "COLMAP model that declares too much",
    given="2^60 images in a file of one, or of what is seen in it",
    expected="refused, without that memory",
)
def test_what_a_model_declares_is_compared_with_its_size(tmp_path, got):
    folder = binary(posed.write_colmap(tmp_path / "a", 1))
    file = folder / "sparse/0/images.bin"
    content = file.read_bytes()
    at = len(content) - 56
    for start in (0, at):
        file.write_bytes(content[:start] + struct.pack("<Q", 2**60) + content[start + 8 :])
        with pytest.raises(UserError, match=r"images\.bin: not a file of a COLMAP model \(ends") as refused:
            read_posed_folder(folder)
    got(str(refused.value).partition(": ")[2])


def view(number: int, size: tuple[int, int]) -> Camera:
    """Inside of a sphere of radius 2 around the origin."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [0.3 * number, 0.7 * number, 0.1]).as_matrix()
    pose[:3, 3] = [0.1 * number, -0.2, 0.3]
    return camera_from_pose(pose, *size, 20.5, 21.25, size[0] / 2 + 0.25, size[1] / 2)


def frame_set(folder: Path, times: tuple[float, ...] = (0, 0, 0)) -> FrameSet:
    """Three frames of a sphere from inside, whose right half is a hole; the last one is held out."""
    (folder / "frames").mkdir(parents=True)
    entries = []
    for number, time in enumerate(times):
        camera = view(number, (12, 8) if number < 2 else (16, 10))
        rays = camera.rays(camera.pixel_centres())
        along = rays @ camera.position
        distance = -along + np.sqrt(along**2 - camera.position @ camera.position + 4)
        depth = (distance * (rays @ camera.camera_to_world[:3, 2])).reshape(camera.height, camera.width)
        depth[:, camera.width // 2 :] = np.inf
        radiance = np.abs(rays).reshape(*depth.shape, 3).astype(np.float32) * 1.2
        plane = depth.astype(np.float32)
        content = CapturedFrame(radiance, radiance, radiance, plane, plane, np.ones(depth.shape, np.int32))
        write_frame(folder / f"frames/{number}.exr", content)
        entry = {**camera_to_json(camera), "file_path": f"frames/{number}.exr", "samples": 1, "time": time}
        entries.append({**entry, "held_out": number == 2})
    scene = {"name": "sphere", "hash": "ab"}
    document = {"format_version": FORMAT_VERSION, "scene": scene, "integrator": "path"}
    (folder / "transforms.json").write_text(json.dumps({**document, "frames": entries}))
    return read_frame_set(folder)


def test_frames_that_go_out_come_back(tmp_path):
    frames = frame_set(tmp_path / "frames")
    assert write_colmap(frames, tmp_path / "out") == (3, 2 * 48 + 80)
    found = read_posed_folder(tmp_path / "out")
    assert [image.held_out for image in found.images] == [False, False, True]
    for image, entry in zip(found.images, frames.entries, strict=True):
        assert np.abs(image.camera.world_to_camera - entry.camera.world_to_camera).max() < 1e-15
        assert replace(image.camera, world_to_camera=entry.camera.world_to_camera) == entry.camera
        expected = bytes_from_radiance(read_frame(entry.file).radiance)
        assert np.array_equal(np.asarray(Image.open(image.file)), expected)
    assert found.points is not None
    assert np.linalg.norm(found.points, axis=1) == pytest.approx(2, abs=1e-6)


def test_points_are_where_images_see_them(tmp_path):
    """As pycolmap reads it, where that is installed."""
    pycolmap = pytest.importorskip("pycolmap")
    write_colmap(frame_set(tmp_path / "frames"), tmp_path / "out")
    found = pycolmap.Reconstruction(str(tmp_path / "out/sparse/0"))
    assert (found.num_images(), found.num_points3D(), found.num_cameras()) == (3, 176, 2)
    assert found.compute_mean_track_length() == 1
    for image in found.images.values():
        colours = np.asarray(Image.open(tmp_path / "out/images" / image.name))
        for seen in image.points2D:
            point = found.points3D[seen.point3D_id]
            assert image.project_point(point.xyz) == pytest.approx(seen.xy, abs=1e-4)
            x, y = np.floor(seen.xy).astype(int)
            assert np.array_equal(colours[y, x], point.color)
    found.write_text(str(tmp_path / "out/sparse/0"))
    for file in (tmp_path / "out/sparse/0").glob("*.bin"):
        file.unlink()
    again = read_posed_folder(tmp_path / "out")
    assert np.allclose(again.points, [found.points3D[n].xyz for n in sorted(found.points3D)], atol=1e-9)


def test_a_written_model_has_tracks_both_ways(tmp_path):
    """Of three points in two of three images, by the bytes of the format's description."""
    tmp_path.joinpath("m").mkdir()
    cameras = {1: ModelCamera("PINHOLE", 4, 3, (2.0, 2.0, 2.0, 1.5))}
    images = [ModelImage(f"{number}.png", 1, np.eye(4)) for number in range(3)]
    positions = np.arange(9.0).reshape(3, 3)
    points = ModelPoints(positions, np.full((3, 3), 7, np.uint8), np.array([0, 0, 2]), positions[:, :2])
    write_model(tmp_path / "m", ColmapModel(cameras, images), points)
    content = (tmp_path / "m/points3D.bin").read_bytes()
    assert struct.unpack_from("<Q", content) == (3,)
    rows = [struct.unpack_from("<Q3d3BdQII", content, 8 + number * 59) for number in range(3)]
    assert len(content) == 8 + 3 * 59
    assert [row[0] for row in rows] == [1, 2, 3]
    assert [row[-2:] for row in rows] == [(1, 0), (1, 1), (3, 0)]
    assert rows[1][1:8] == (3, 4, 5, 7, 7, 7, 0)
    found = read_model(tmp_path / "m")
    assert np.array_equal(found.points, positions)
    assert [image.name for image in found.images] == ["0.png", "1.png", "2.png"]


def test_what_cannot_be_written_is_refused_and_leaves_nothing(tmp_path):
    moving = frame_set(tmp_path / "moving", (0.0, 0.5, 1.0))
    with pytest.raises(UserError, match="its frames show several times, which COLMAP's format does not have"):
        write_colmap(moving, tmp_path / "out")
    still = frame_set(tmp_path / "still")
    still.entries[2].file.write_bytes(b"")
    with pytest.raises(UserError, match=r"2\.exr: not a readable frame"):
        write_colmap(still, tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["moving", "still"]
    with pytest.raises(UserError, match="exists already"):
        write_colmap(still, tmp_path / "moving")


def test_points_are_as_many_as_colmap_finds(tmp_path, monkeypatch):
    monkeypatch.setattr("pathtrace.dataset.colmap_layout._MOST_POINTS", 60)
    _, count = write_colmap(frame_set(tmp_path / "frames"), tmp_path / "out")
    assert 20 <= count <= 60
    model = model_of(tmp_path / "out")
    assert model is not None
    assert len(read_colmap(tmp_path / "out", model)[1]) == count


def test_points_of_real_cameras_come_back(tmp_path):
    """Three photographs of a garden, whose cameras and points COLMAP found."""
    with np.load(real_file("splats/garden_sfm/test_garden.npz")) as found:
        positions, colours = found["means3d"].astype(np.float64), found["colors"]
        poses, (lens, *_) = found["viewmats"].astype(np.float64), found["Ks"].astype(np.float64)
        size = int(found["width"]), int(found["height"])
    model = tmp_path / "a/sparse/0"
    camera = ModelCamera("PINHOLE", *size, (lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2]))
    images = [ModelImage(f"{number}.png", 1, pose) for number, pose in enumerate(poses)]
    first = np.zeros(len(positions), np.int64)
    points = ModelPoints(positions, colours, first, positions[:, :2])
    write_model(model, ColmapModel({1: camera}, images), points)
    (tmp_path / "a/images").mkdir()
    for image in images:
        Image.new("RGB", size).save(tmp_path / "a/images" / image.name)
    back = read_posed_folder(tmp_path / "a")
    assert np.array_equal(back.points, positions)
    for image, pose in zip(back.images, poses, strict=True):
        assert np.allclose(image.camera.world_to_camera, pose, atol=1e-6)
        # About half of the points are seen by each of the cameras.
        assert image.camera.shows(positions)[1].mean() > 0.3
