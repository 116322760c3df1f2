"""EXR files: what is declared is checked before anything is allocated, and damage is noticed."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from compose.image.exr import read_channels, write_channels
from tests import small
from tests.extremes import extreme


@pytest.fixture
def file(tmp_path) -> Path:
    """Five rows and seven columns of three types."""
    rng = small.rng()
    channels = {
        "R": rng.normal(size=(5, 7)).astype(np.float32),
        "albedo.G": rng.uniform(size=(5, 7)).astype(np.float16),
        "shape.V": rng.integers(0, 9, (5, 7)).astype(np.uint32),
    }
    write_channels(tmp_path / "a.exr", channels)
    return tmp_path / "a.exr"


def edited(file: Path, name: bytes, value: bytes) -> Path:
    """The file with the value of an attribute replaced by one of the same length."""
    content = bytearray(file.read_bytes())
    at = content.index(name + b"\0") + len(name) + 1
    at = content.index(b"\0", at) + 5
    content[at : at + len(value)] = value
    file.write_bytes(content)
    return file


def test_channels_read_back(file):
    channels = read_channels(file, (7, 5))
    assert {name: str(values.dtype) for name, values in channels.items()} == {
        "R": "float32",
        "albedo.G": "float16",
        "shape.V": "uint32",
    }
    with pytest.raises(ValueError, match="7 x 5 pixels instead of 5 x 7"):
        read_channels(file, (5, 7))


def test_files_without_a_checksum_are_read(tmp_path):
    """Of other programs, or of earlier versions."""
    values = np.ones((2, 3), dtype=np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"R": values}).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_channels(tmp_path / "a.exr")["R"], values)


@pytest.mark.parametrize(
    ("window", "said"),
    [
        pytest.param(
            (0, 0, 2**31 - 2, 2**31 - 2),
            "declares 2147483647 x 2147483647 pixels",
            marks=extreme(
                "EXR window of 2^31", given="data window of 2^31 - 1 a side, 500 bytes", expected="refused"
            ),
        ),
        pytest.param(
            (-(2**31), -(2**31), 2**31 - 1, 2**31 - 1),
            "declares 4294967296 x 4294967296",
            marks=extreme("EXR window of all integers", given="from -2^31 to 2^31 - 1", expected="refused"),
        ),
        pytest.param(
            (0, 0, 9999, 9999),
            "truncated: declares 10000 x 10000 pixels, more than",
            marks=extreme(
                "EXR window beyond its bytes", given="10^8 pixels declared by 500 bytes", expected="refused"
            ),
        ),
        ((0, 0, -1, 4), "declares 0 x 5 pixels"),
        ((6, 4, 0, 0), "declares -5 x -3"),
    ],
)
def test_a_window_that_the_file_cannot_hold_is_refused(file, window, said, monkeypatch, request):
    """Before OpenEXR sees the file."""
    edited(file, b"dataWindow", struct.pack("<4i", *window))
    monkeypatch.setattr(OpenEXR, "File", None)
    with pytest.raises(ValueError, match=said) as caught:
        read_channels(file)
    if request.node.get_closest_marker("extremes"):
        request.getfixturevalue("got")(str(caught.value))


def test_other_kinds_of_file_are_refused(file):
    whole = file.read_bytes()
    for at, value in ((0, 0), (4, 3), (5, 0x02), (5, 0x10), (6, 1)):
        content = bytearray(whole)
        content[at] = value
        file.write_bytes(content)
        with pytest.raises(ValueError, match="not an EXR file of one part in scan lines"):
            read_channels(file)
    file.write_bytes(whole)
    with pytest.raises(ValueError, match="compressed neither by ZIP nor at all"):
        read_channels(edited(file, b"compression", b"\x04"))


@extreme(
    "EXR truncated anywhere",
    given="a file of some 500 bytes cut at 0, 1, 2 and every 7th",
    expected="every one refused",
)
def test_every_truncation_is_refused(file, got):
    whole = file.read_bytes()
    lengths = sorted({0, 1, 2, *range(3, len(whole), 7), len(whole) - 1})
    for length in lengths:
        file.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"."):
            read_channels(file)
    got(f"{len(lengths)} of {len(lengths)} refused")


@extreme(
    "EXR with flipped bits",
    given="a bit of each byte flipped, one at a time",
    expected="refused, or the same values",
)
def test_a_flipped_bit_is_refused_or_changes_nothing(file, got):
    whole, expected = file.read_bytes(), read_channels(file)
    refused = harmless = 0
    for at, bit in enumerate(small.rng().integers(0, 8, len(whole))):
        content = bytearray(whole)
        content[at] ^= 1 << bit
        file.write_bytes(content)
        try:
            found = read_channels(file)
        except ValueError:
            refused += 1
            continue
        assert all(np.array_equal(found[name], values) for name, values in expected.items()), (at, bit)
        harmless += 1
    got(f"{refused} refused, {harmless} harmless of {len(whole)}")
