"""Files made to do harm: each is refused in one line, before memory is allocated; no code is run."""

from __future__ import annotations

import json
import os
import pickle
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.eye.gaze import load_gaze_trace
from hybrid.base.identity import Journal
from hybrid.render.image_files import read_exr
from hybrid.window.gaze_input import unused_file
from pathtrace.dataset.captured_frames import read_frame
from pathtrace.dataset.frame_set import read_frame_set
from splat.io.forest_file import load_forest
from splat.io.ply import load_ply, save_ply
from splat.io.tensors import load_tensors, save_tensors
from tests.extremes import extreme
from tests.fuzz.readers import READERS, good
from tests.splat.samples import gaussians

pytestmark = pytest.mark.usefixtures("backend")


def safetensors(header: object, body: bytes = b"") -> bytes:
    text = (header if isinstance(header, str) else json.dumps(header)).encode()
    return struct.pack("<Q", len(text)) + text + body


def tensor(start: int, end: int, shape: list[int]) -> dict[str, object]:
    return {"dtype": "F32", "shape": shape, "data_offsets": [start, end]}


HEADERS = {
    "safetensors of terabytes": ("a tensor of 2^40 values, 8 bytes", {"a": tensor(0, 2**42, [2**40])}),
    "safetensors that overlap": (
        "two tensors at the same place",
        {"a": tensor(0, 8, [2]), "b": tensor(4, 8, [1])},
    ),
    "safetensors with a negative place": ("offsets -8 to 0", {"a": tensor(-8, 0, [2])}),
    "safetensors that end first": ("offsets 8 to 0", {"a": tensor(8, 0, [2])}),
    "safetensors shape that overflows": (
        "2^32 x 2^32 values in 8 bytes",
        {"a": tensor(0, 8, [2**32, 2**32])},
    ),
    "safetensors with deep metadata": (
        "metadata nested 100,000 deep",
        {"__metadata__": {"hybrid": "[" * 100_000}, "a": tensor(0, 8, [2])},
    ),
    "safetensors header nested deep": ("the header itself, 100,000 deep", '{"a":' * 100_000),
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=extreme(n, given=v[0], expected="refused")) for n, v in HEADERS.items()]
)
def test_headers_that_declare_what_is_not_there_are_refused(name, tmp_path, got):
    (tmp_path / "a").write_bytes(safetensors(HEADERS[name][1], bytes(8)))
    with pytest.raises(UserError, match=r"a: truncated or corrupt \(.*\); make it again") as caught:
        load_tensors(tmp_path / "a")
    assert str(caught.value).isprintable()
    got(str(caught.value).replace(str(tmp_path), ""))


@extreme("safetensors header of 2^63 bytes", given="8 bytes that say so", expected="refused")
def test_a_header_longer_than_the_file_is_refused(tmp_path, got):
    (tmp_path / "a").write_bytes(struct.pack("<Q", 2**63))
    with pytest.raises(UserError, match="truncated or corrupt") as caught:
        load_tensors(tmp_path / "a")
    got(str(caught.value).replace(str(tmp_path), ""))


@extreme("pickle as a forest", given="a pickle that would write a file", expected="refused, nothing run")
def test_nothing_is_unpickled(tmp_path, got):
    class Harm:
        def __reduce__(self):
            return os.system, (f"touch {tmp_path}/ran",)

    for content in (pickle.dumps(Harm()), b"PK\x03\x04" + pickle.dumps(Harm())):
        (tmp_path / "a").write_bytes(content)
        for read in (load_forest, load_ply):
            with pytest.raises(UserError):
                read(tmp_path / "a")
    torch.save({"a": 1}, tmp_path / "a")
    with pytest.raises(UserError):
        load_forest(tmp_path / "a")
    assert not (tmp_path / "ran").exists()
    got("refused, nothing run")


CHANGES = {
    "types": lambda t, m: t.update(means=t["means"].double()),
    "integers": lambda t, m: t.update(opacity_logits=t["opacity_logits"].int()),
    "wide parents": lambda t, m: t.update(parent=t["parent"].long()),
    "no axis": lambda t, m: t.update(opacity_logits=torch.tensor(1.0)),
    "negative layer": lambda t, m: m.update(layers=[-1, sum(m["layers"]) + 1]),
    "a million layers": lambda t, m: m.update(layers=[0] * 1_000_000 + m["layers"]),
    "a number as layers": lambda t, m: m.update(layers=3),
    "fractions": lambda t, m: m.update(layers=[float(n) for n in m["layers"]]),
    "infinite focal": lambda t, m: m.update(trained_focal=1e300 * 1e300),
    "name as a path": lambda t, m: m.update(scene_name="../../x"),
    "name of two lines": lambda t, m: m.update(scene_name="a\nb"),
    "long name": lambda t, m: m.update(scene_name="n" * 1000),
    "name as a list": lambda t, m: m.update(scene_name=["a"]),
    "hash as a path": lambda t, m: m.update(scene_hash="/etc/passwd"),
}


@extreme(
    "hostile forests",
    given="14: other types and shapes, negative and a million layers, names and hashes that are paths",
    expected="each refused in one line",
)
def test_forests_that_kernels_or_paths_would_misread_are_refused(tmp_path, got):
    good(READERS["forest"], tmp_path / "g")
    for name, change in CHANGES.items():
        tensors, metadata = load_tensors(tmp_path / "g" / "a.forest")
        change(tensors, metadata)
        save_tensors(tmp_path / "b", tensors, metadata)
        with pytest.raises(UserError, match=r"b: .*; train it again$") as caught:
            load_forest(tmp_path / "b")
        assert str(caught.value).isprintable(), name
    got(f"{len(CHANGES)} refused")


PLY = "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{}end_header\n"


@pytest.mark.parametrize(
    ("count", "said"),
    [
        pytest.param(
            10**17,
            "element vertex 100000000000000000: not a number of rows that it can hold",
            marks=extreme(
                "PLY of 10^17 Gaussians", given="declared by a file of 700 bytes", expected="refused"
            ),
        ),
        pytest.param(
            40_000_000,
            "element vertex 40000000: not a number of rows that it can hold",
            marks=extreme(
                "PLY beyond its bytes", given="40 million Gaussians declared by 700 bytes", expected="refused"
            ),
        ),
    ],
)
def test_a_ply_that_declares_what_is_not_there_is_refused(count, said, tmp_path, got):
    names = [line for line in _ply_header(tmp_path) if line.startswith("property")]
    (tmp_path / "b.ply").write_text(PLY.format(count, "\n".join(names) + "\n"))
    with pytest.raises(UserError, match=said) as caught:
        load_ply(tmp_path / "b.ply")
    got(str(caught.value).replace(str(tmp_path), ""))


def _ply_header(folder: Path) -> list[str]:
    save_ply(folder / "a.ply", gaussians("overlap", n=5, degree=0))
    return (folder / "a.ply").read_bytes().split(b"end_header")[0].decode().split("\n")


@pytest.mark.parametrize(
    "value",
    [
        pytest.param(
            np.nan,
            marks=extreme(
                "PLY with NaN", given="scale_1 of Gaussian 4 of 5", expected="refused by both names"
            ),
        ),
        np.inf,
        -np.inf,
    ],
)
def test_the_first_bad_gaussian_of_a_ply_is_named(value, tmp_path, request):
    lines = _ply_header(tmp_path)
    names = [line.split()[-1] for line in lines if line.startswith("property")]
    head, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    table = np.frombuffer(body, "<f4").reshape(5, -1).copy()
    table[3, names.index("scale_1")] = table[4, names.index("x")] = value
    # What is not read may be anything.
    table[0, names.index("nx")] = value
    (tmp_path / "a.ply").write_bytes(head + b"end_header\n" + table.tobytes())
    with pytest.raises(
        UserError, match=rf"a\.ply: Gaussian 4: scale_1 is {value}; must be a finite"
    ) as caught:
        load_ply(tmp_path / "a.ply")
    if request.node.get_closest_marker("extremes"):
        request.getfixturevalue("got")(str(caught.value).replace(str(tmp_path), ""))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        pytest.param(
            {"file_path": "../../../etc/passwd"},
            "is not the name of a file in the folder",
            marks=extreme(
                "frame outside its folder", given="file_path ../../../etc/passwd", expected="refused"
            ),
        ),
        ({"file_path": "/etc/passwd"}, "is not the name of a file in the folder"),
        ({"file_path": 3}, "is not the name of a file in the folder"),
        ({"file_path": "n" * 5000}, "is not the name of a file in the folder"),
        ({"file_path": "\ud800"}, "is not the name of a file in the folder"),
        ({"samples": -1}, "samples -1: must be positive"),
        ({"samples": 1e300}, "must be positive, with 32 bits"),
        pytest.param(
            {"w": 2**40, "h": 2**40},
            "at most 134,217,728 pixels",
            marks=extreme("camera of 2^80 pixels", given="w and h 2^40", expected="refused"),
        ),
        pytest.param(
            {"transform_matrix": np.zeros((4, 4)).tolist()},
            "not rigid",
            marks=extreme("camera without a direction", given="a matrix of zeros", expected="refused"),
        ),
        ({"transform_matrix": (1e200 * np.eye(4)).tolist()}, "not rigid"),
    ],
)
def test_frame_sets_that_lead_outside_or_ask_for_too_much_are_refused(change, said, tmp_path, request):
    document = json.loads(good(READERS["frame set"], tmp_path / "g"))
    document["frames"][0] |= change
    (tmp_path / "g" / "transforms.json").write_text(json.dumps(document))
    with pytest.raises(UserError, match=said) as caught:
        read_frame_set(tmp_path / "g")
    if request.node.get_closest_marker("extremes"):
        request.getfixturevalue("got")(str(caught.value).replace(str(tmp_path), ""))


@extreme("frame of another size", given="6 x 4 pixels where the camera has 4 x 6", expected="refused")
def test_a_frame_of_another_size_than_its_camera_is_refused(tmp_path, got):
    good(READERS["frame"], tmp_path / "g")
    with pytest.raises(UserError, match=r"6 x 4 pixels instead of 4 x 6.*; capture it again") as caught:
        read_frame(tmp_path / "g" / "a.exr", (4, 6))
    got(str(caught.value).replace(str(tmp_path), ""))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        pytest.param(
            b"seconds,x,y\n" + b"1" * 200_000 + b",0,0\n",
            "field larger than field limit",
            id="long",
            marks=extreme("gaze in one long field", given="a field of 200,000 digits", expected="refused"),
        ),
        pytest.param(
            b"seconds,x,y\n0,\0,0.5\n",
            "g.csv: ",
            marks=extreme("gaze with a NUL byte", given="NUL in the place of x", expected="refused"),
        ),
        pytest.param(
            b"seconds,x,y\n1e999,0.5,0.5\n",
            "time 1e999 must be a number",
            marks=extreme("gaze at infinity", given="time 1e999", expected="refused by line"),
        ),
        (b'seconds,x,y\n"a\nb",0.5,0.5\n', "line 2 is not a gaze"),
        (b"seconds,x,y\n0,1e999,0.5\n", "line 2 is not a gaze"),
    ],
)
def test_gaze_traces_that_are_none_are_refused(content, said, tmp_path, request):
    (tmp_path / "g.csv").write_bytes(content)
    with pytest.raises(UserError, match=said) as caught:
        load_gaze_trace(tmp_path / "g.csv")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 600
    if request.node.get_closest_marker("extremes"):
        request.getfixturevalue("got")(str(caught.value).replace(str(tmp_path), ""))


@extreme(
    "files of a terabyte", given="sparse files of 2^40 bytes, all readers", expected="each refused unread"
)
def test_a_file_of_a_terabyte_is_refused_before_it_is_read(tmp_path, got):
    """They take no room on the disk; reading one would take an hour."""
    for name, reader in READERS.items():
        good(reader, tmp_path / name)
        file = tmp_path / name / reader.name
        with file.open("rb+") as opened:
            opened.truncate(2**40)
        with pytest.raises(reader.errors):
            reader.read(file)
        file.unlink()
    got(f"{len(READERS)} refused")


_LIMITED = """
import resource, sys
from pathlib import Path
import compose.image.exr, splat.io.tensors, splat.io.ply, compose.base.files
from compose.base.errors import UserError
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (64 << 20),) * 2)
refused = 0
for name in sys.argv[1:]:
    try:
        path = Path(name)
        if path.suffix == ".exr": compose.image.exr.read_channels(path)
        elif path.suffix == ".ply": splat.io.ply.load_ply(path)
        elif path.suffix == ".json": compose.base.files.read_json(path)
        else: splat.io.tensors.load_tensors(path)
    except (UserError, ValueError):
        refused += 1
print(refused)
"""


@extreme(
    "declared sizes in 64 MiB",
    given="EXR, PLY, safetensors and JSON that declare more than the process may allocate",
    expected="refused, no MemoryError",
)
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_declared_sizes_are_refused_in_little_memory(tmp_path, got):
    good(READERS["EXR"], tmp_path / "e")
    content = bytearray((tmp_path / "e" / "b.exr").read_bytes())
    at = content.index(b"dataWindow\0box2i\0") + 21
    content[at : at + 16] = struct.pack("<4i", 0, 0, 11_000, 11_000)
    (tmp_path / "a.exr").write_bytes(content)
    names = [line for line in _ply_header(tmp_path) if line.startswith("property")]
    (tmp_path / "b.ply").write_text(PLY.format(40_000_000, "\n".join(names) + "\n"))
    (tmp_path / "a.tensors").write_bytes(safetensors({"a": tensor(0, 2**42, [2**40])}, bytes(8)))
    (tmp_path / "a.json").write_text("[" * 1_000_000)
    files = [tmp_path / name for name in ("a.exr", "b.ply", "a.tensors", "a.json")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", _LIMITED, *map(str, files)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert got(int(done.stdout)) == len(files)


def test_a_name_for_the_windows_files_stays_in_its_folder(tmp_path):
    assert unused_file(tmp_path, "room", ".png").parent == tmp_path


def test_names_in_files_do_not_break_the_line(tmp_path):
    """An attribute of an EXR file that is named twice, with a line break; a journal with a long name."""
    content = good(READERS["EXR"], tmp_path / "e")
    entry = b"a\nb\0string\0" + struct.pack("<i", 1) + b"x"
    (tmp_path / "a.exr").write_bytes(content[:8] + 2 * entry + content[8:])
    (tmp_path / "j.json").write_text(json.dumps({"identity": {"n\n" * 5000: 1}, "results": {}}))
    for read in (
        lambda: read_exr(tmp_path / "a.exr"),
        lambda: read_frame(tmp_path / "a.exr"),
        lambda: Journal(tmp_path / "j.json", {"a": 1}),
    ):
        with pytest.raises(UserError) as caught:
            read()
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 600
