"""Folders of posed images: their layouts, and what is refused of them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from compose.base.errors import UserError
from compose.image.colour import srgb_from_radiance
from pathtrace.dataset.posed_images import Lens, read_pixels
from pathtrace.dataset.posed_layouts import NERFSTUDIO, is_posed_folder, read_posed_folder
from tests import posed
from tests.extremes import extreme


def edited(file: Path, change: Callable[[dict], object]) -> None:
    """Changes a JSON file."""
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def test_frames_of_d_nerf_have_the_cameras_and_times_of_their_files(tmp_path):
    found = read_posed_folder(posed.write_synthetic(tmp_path / "ball"))
    assert (found.scene_name, len(found.scene_hash)) == ("ball", 64)
    assert (len(found.training), len(found.held_out)) == (6, 2)
    assert found.moves
    assert found.points is None
    for number, image in enumerate(found.images):
        expected = posed.camera(number)
        assert np.allclose(image.camera.world_to_camera, expected.world_to_camera, atol=1e-12)
        assert (image.camera.fx, image.camera.cx) == pytest.approx((expected.fx, expected.cx))
    assert [image.time for image in found.training] == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1])


def test_frames_without_times_do_not_move(tmp_path):
    assert not read_posed_folder(posed.write_synthetic(tmp_path / "a", moving=False)).moves


def test_validation_frames_are_held_out_where_there_are_no_test_frames(tmp_path):
    folder = posed.write_synthetic(tmp_path / "a")
    (folder / "transforms_test.json").rename(folder / "transforms_val.json")
    assert len(read_posed_folder(folder).held_out) == 2


LENS = {"w": 96, "h": 64, "fl_x": 90.0, "fl_y": 80.0, "cx": 50.0, "cy": 30.0, "k1": -0.05, "p2": 0.01}


def described_together(folder: Path, count: int = 6, **more: Any) -> Path:
    """A folder in the layout of nerfstudio, with images of half the size that its cameras have."""
    posed.write_synthetic(folder, training=count, held_out=0, moving=False)
    content = json.loads((folder / "transforms_train.json").read_text())
    frames = [{**frame, "file_path": frame["file_path"] + ".png"} for frame in content["frames"]]
    for name in ("transforms_train.json", "transforms_test.json"):
        (folder / name).unlink()
    (folder / "transforms.json").write_text(json.dumps({**LENS, "frames": frames, **more}))
    return folder


def test_cameras_of_nerfstudio_have_their_lens_at_the_size_of_their_images(tmp_path):
    found = read_posed_folder(described_together(tmp_path / "a"))
    assert found.layout == NERFSTUDIO
    assert len(found.training) == 6
    for number, image in enumerate(found.images):
        camera = image.camera
        assert np.allclose(camera.world_to_camera, posed.camera(number).world_to_camera, atol=1e-12)
        assert (camera.width, camera.height) == (posed.WIDTH, posed.HEIGHT)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((45, 40, 25, 15))
        assert image.lens == Lens((-0.05, 0.0, 0.0), (0.0, 0.01))


def test_a_frame_may_have_a_lens_of_its_own(tmp_path):
    folder = described_together(tmp_path / "a")
    edited(folder / "transforms.json", lambda content: content["frames"][2].update(fl_x=100.0, k1=0, p2=0))
    images = read_posed_folder(folder).images
    assert [image.camera.fx for image in images[1:4]] == pytest.approx([45, 50, 45])
    assert images[2].lens is None


@pytest.mark.parametrize(
    ("more", "held_out"),
    [
        ({}, [0, 8]),
        ({"test_filenames": ["./train/r_003.png"], "val_filenames": ["train/r_001.png"]}, [3]),
        ({"val_filenames": ["train/r_001.png"]}, [1]),
    ],
)
def test_nerfstudio_says_what_is_held_out_else_every_eighth_frame_is(tmp_path, more, held_out):
    images = read_posed_folder(described_together(tmp_path / "a", 10, **more)).images
    assert [number for number, image in enumerate(images) if image.held_out] == held_out


def test_a_frame_set_of_ones_own_is_no_folder_of_posed_images(tmp_path):
    folder = described_together(tmp_path / "a")
    assert is_posed_folder(folder)
    edited(folder / "transforms.json", lambda content: content.update(format_version=1))
    assert not is_posed_folder(folder)


def test_images_may_be_jpeg_and_named_as_windows_does(tmp_path):
    folder = posed.write_synthetic(tmp_path / "a", alpha=False)
    for file in folder.rglob("*.png"):
        Image.open(file).convert("RGB").save(file.with_suffix(".jpg"), quality=100, subsampling=0)
        file.unlink()
    edited(
        folder / "transforms_train.json",
        lambda content: content["frames"][1].update(file_path="train\\r_001.jpg"),
    )
    found = read_posed_folder(folder)
    assert {image.file.suffix for image in found.images} == {".jpg"}
    _, _, colour = posed.cast(posed.camera(0), 0.0)
    shown = srgb_from_radiance(read_pixels(found.images[0]).radiance)
    assert np.abs(shown - colour).max() < 0.03


def test_a_field_of_view_may_be_given_for_each_side(tmp_path):
    folder = posed.write_synthetic(tmp_path / "a")
    angle = 2 * np.arctan(posed.HEIGHT / 2 / 30.0)
    edited(folder / "transforms_train.json", lambda content: content.update(camera_angle_y=angle))
    camera = read_posed_folder(folder).images[0].camera
    assert (camera.fx, camera.fy) == pytest.approx((posed.FOCAL, 30))


def test_frames_of_nerfies_are_scaled_around_their_centre(tmp_path):
    found = read_posed_folder(posed.write_nerfies(tmp_path / "a"))
    assert (len(found.training), len(found.held_out)) == (6, 2)
    for image in found.images:
        number = int(image.file.stem)
        expected = posed.camera(number)
        assert np.allclose(image.camera.world_to_camera, expected.world_to_camera, atol=1e-12)
        assert image.camera.fx == pytest.approx(expected.fx)
        assert image.time == pytest.approx(number / 7)
        assert image.lens is None
        assert image.labels is None
    assert found.bounds == (1.5, 6.0)
    # Points on the ball and on the wall, in the coordinates of the cameras.
    assert found.points is not None
    assert found.points[:, 2].max() == pytest.approx(posed.WALL)
    assert found.points[:, 2].min() == pytest.approx(-posed.RADIUS, abs=0.05)


def test_time_ids_come_before_warp_ids_and_end_at_one(tmp_path):
    folder = posed.write_nerfies(tmp_path / "a")

    def later(content):
        for number, entry in enumerate(content.values()):
            entry["time_id"] = 4 * number

    edited(folder / "metadata.json", later)
    assert max(image.time for image in read_posed_folder(folder).images) == 1


def test_images_of_one_megapixel_at_most_are_read(tmp_path):
    folder = posed.write_nerfies(tmp_path / "a")
    for file in (folder / "rgb/1x").iterdir():
        Image.new("RGB", (1536, 1024)).save(file)
        Image.new("RGB", (768, 512)).save(folder / "rgb/2x" / file.name)
        edited(folder / f"camera/{file.stem}.json", lambda camera: camera.update(image_size=[1536, 1024]))
    camera = read_posed_folder(folder).images[0].camera
    assert (camera.width, camera.height) == (768, 512)
    assert (camera.fx, camera.cx) == pytest.approx((posed.FOCAL / 2, posed.WIDTH / 4))


@pytest.mark.parametrize("suffix", [".png", ".png.png"])
def test_labels_belong_to_images(tmp_path, suffix):
    found = read_posed_folder(posed.write_nerfies(tmp_path / "a", labels=suffix))
    assert [image.labels.name for image in found.images] == [f"{i.file.stem}{suffix}" for i in found.images]


def test_what_is_both_trained_on_and_validated_is_held_out(tmp_path):
    folder = posed.write_nerfies(tmp_path / "a")
    edited(folder / "dataset.json", lambda ids: ids.update(train_ids=ids["ids"]))
    found = read_posed_folder(folder)
    assert (len(found.training), len(found.held_out)) == (6, 2)


def test_the_hash_follows_each_image_and_camera(tmp_path):
    folder = posed.write_synthetic(tmp_path / "a")
    first = read_posed_folder(folder).scene_hash
    assert read_posed_folder(folder).scene_hash == first
    copy = tmp_path / "b"
    shutil.copytree(folder, copy)
    assert read_posed_folder(copy).scene_hash == first
    image = np.array(Image.open(copy / "test/r_001.png"))
    image[3, 4, 0] ^= 1
    Image.fromarray(image).save(copy / "test/r_001.png")
    assert read_posed_folder(copy).scene_hash != first
    edited(folder / "transforms_train.json", lambda content: content.update(camera_angle_x=1.0))
    assert read_posed_folder(folder).scene_hash != first


def test_folders_are_recognized(tmp_path):
    assert is_posed_folder(posed.write_synthetic(tmp_path / "a"))
    assert is_posed_folder(posed.write_nerfies(tmp_path / "b"))
    assert not is_posed_folder(tmp_path)
    assert not is_posed_folder(tmp_path / "nowhere")


def frame_of(number: int, **values: object) -> Callable[[Path], None]:
    """Changes a frame of transforms_train.json."""
    return lambda folder: edited(
        folder / "transforms_train.json", lambda content: content["frames"][number].update(values)
    )


SYNTHETIC = {
    "a missing image": (lambda f: (f / "train/r_002.png").unlink(), "r_002.png: this image is missing"),
    "broken JSON": (
        lambda f: (f / "transforms_train.json").write_text('{"frames": ['),
        "transforms_train.json: not a JSON file that can be read",
    ),
    "a time beyond 1": (frame_of(3, time=1.5), "frame 3: time 1.5: must be from 0 to 1"),
    "a time that is no number": (frame_of(3, time="noon"), "frame 3: could not convert"),
    "NaN in a matrix": (
        lambda f: (f / "transforms_train.json").write_text(
            (f / "transforms_train.json").read_text().replace("0.0, 0.0, 0.0, 1.0", "0.0, NaN, 0.0, 1.0", 1)
        ),
        "NaN is not a number",
    ),
    "a matrix that scales": (frame_of(0, transform_matrix=np.diag([2, 2, 2, 1]).tolist()), "not rigid"),
    "a matrix of 3 x 3": (frame_of(0, transform_matrix=np.eye(3).tolist()), "must be 4 x 4 finite numbers"),
    "a file elsewhere": (frame_of(1, file_path="../../etc/a"), "is not the name of a file in the folder"),
    "no frames": (
        lambda f: edited(f / "transforms_train.json", lambda content: content.update(frames=[])),
        "holds no frames to train on",
    ),
    "no field of view": (
        lambda f: edited(f / "transforms_train.json", lambda content: content.pop("camera_angle_x")),
        "frame 0 has no 'camera_angle_x'",
    ),
    "a field of view of a whole turn": (
        lambda f: edited(f / "transforms_train.json", lambda content: content.update(camera_angle_x=6.3)),
        "camera_angle_x 6.3: must be in radians",
    ),
    "a lens that sees all around": (
        frame_of(1, camera_model="OPENCV_FISHEYE"),
        "frame 1: camera_model OPENCV_FISHEYE: must be one of OPENCV",
    ),
    "a coefficient of a fisheye": (frame_of(0, k4=0.1), "k4 0.1: only k1, k2, k3, p1 and p2 are known"),
    "no focal length": (frame_of(0, fl_x=0), "w, h, fl_x and fl_y must be positive"),
    "an endless coefficient": (frame_of(0, fl_x=40, p1=1e400), "is not a number"),
    "a text as an image": (
        lambda f: (f / "train/r_001.png").write_text("hello"),
        "r_001.png: not a readable image",
    ),
    "32 bits per channel": (
        lambda f: Image.fromarray(np.ones((8, 8), np.float32)).save(f / "train/r_001.png", format="TIFF"),
        "must have 8 bits per channel, or 16 in a PNG file",
    ),
}
NERFIES = {
    "a missing camera": (lambda f: (f / "camera/000001.json").unlink(), "000001.json: this file is missing"),
    "a missing scene": (lambda f: (f / "scene.json").unlink(), "scene.json: this file is missing"),
    "a missing label": (lambda f: (f / "mask/1x/000001.png").unlink(), "000001.png: this image is missing"),
    "labels of another size": (
        lambda f: Image.new("L", (24, 16)).save(f / "mask/1x/000001.png"),
        "mask/1x/000001.png: 24 x 16 pixels; must be 48 x 32, as of the image",
    ),
    "an image of another size": (
        lambda f: Image.new("RGB", (30, 32)).save(f / "rgb/1x/000001.png"),
        "its image at 1x has 30 x 32 pixels",
    ),
    "no time": (
        lambda f: edited(f / "metadata.json", lambda content: content["000001"].pop("warp_id")),
        "000001 has no 'warp_id'",
    ),
    "a negative time": (
        lambda f: edited(f / "metadata.json", lambda content: content["000001"].update(warp_id=-3)),
        "must be from 0 to 1",
    ),
    "no images": (lambda f: shutil.rmtree(f / "rgb"), "rgb: has no folder of images"),
    "no training ids": (
        lambda f: edited(f / "dataset.json", lambda content: content.update(train_ids=[])),
        "holds no frames to train on",
    ),
    "an id elsewhere": (
        lambda f: edited(f / "dataset.json", lambda content: content.update(train_ids=["../a"])),
        "metadata.json: ../a has no '../a'",
    ),
    "an orientation that mirrors": (
        lambda f: edited(
            f / "camera/000001.json", lambda content: content.update(orientation=np.diag([1, 1, -1]).tolist())
        ),
        "it mirrors",
    ),
    "a lens that is not finite": (
        lambda f: edited(
            f / "camera/000001.json", lambda content: content.update(radial_distortion=["nan", 0, 0])
        ),
        "distortion has a number that is not finite",
    ),
    "a scale of zero": (
        lambda f: edited(f / "scene.json", lambda content: content.update(scale=0)),
        "scale positive",
    ),
    "near beyond far": (
        lambda f: edited(f / "scene.json", lambda content: content.update(near=9)),
        "near 9, far 6.0",
    ),
    "points that are a pickle": (
        lambda f: np.save(f / "points.npy", np.array([{}], dtype=object), allow_pickle=True),
        "points.npy: not a file of points",
    ),
    "points of two numbers": (
        lambda f: np.save(f / "points.npy", np.ones((5, 2))),
        r"points.npy: not a file of points \(float64 of shape \(5, 2\)",
    ),
}


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        pytest.param(
            name,
            spoil,
            message,
            marks=extreme(f"frames of others: {name}", given=layout, expected="refused in one line"),
        )
        for layout, mistakes in (("D-NeRF", SYNTHETIC), ("NeRF-DS", NERFIES))
        for name, (spoil, message) in mistakes.items()
    ],
)
def test_what_makes_no_frames_is_refused_in_one_line(tmp_path, name, spoil, message, got):
    folder = tmp_path / "a"
    if name in SYNTHETIC:
        posed.write_synthetic(folder)
    else:
        posed.write_nerfies(folder, labels=".png")
    spoil(folder)
    with pytest.raises(UserError, match=message) as caught:
        read_posed_folder(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)
    got("refused")


def test_an_unknown_layout_is_refused_by_name(tmp_path):
    with pytest.raises(UserError, match=r"unknown layout; must be that of NeRF-synthetic or D-NeRF"):
        read_posed_folder(tmp_path)


@pytest.mark.parametrize("name", ["...", ".hidden", "a" * 250])
@extreme(
    "frames of others in a folder with a name that no scene can have",
    given="dots alone, a dot in front, 250 letters",
    expected="a name that a scene can have",
)
def test_a_folder_of_any_name_gives_a_scene_one(tmp_path, name, got):
    found = read_posed_folder(posed.write_synthetic(tmp_path / name, training=1, held_out=0))
    assert got(found.scene_name) in ("frames", "hidden", "a" * 200)
