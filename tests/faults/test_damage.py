"""Files that a crash cut off or in which a bit flipped: noticed, or without effect."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.base.identity import Journal
from hybrid.evaluation.evaluation import stored_reference
from hybrid.measure.reference import Reference
from splat.io.forest_file import load_forest
from tests import small
from tests.extremes import extreme
from tests.fuzz.readers import IDENTITY, READERS, good

pytestmark = pytest.mark.usefixtures("backend")

# PLY has no checksum of its own; what people write by hand has none either.
CHECKED = ("forest", "compact forest", "tensors", "frame", "EXR", "journal")


def _same(name: str) -> Callable[[Path], object]:
    """What must not change without notice, of a file."""
    if name == "journal":
        return lambda path: Journal(path, IDENTITY)["first"]
    if name.endswith("forest"):
        return lambda path: (load_forest(path).digest(), load_forest(path).nodes.parent.tolist())
    return lambda path: _bytes(READERS[name].read(path))


def _bytes(found: object) -> object:
    """Values of arrays, wherever they lie."""
    if isinstance(found, tuple):
        return [_bytes(one) for one in found]
    if isinstance(found, dict):
        return {key: _bytes(value) for key, value in found.items()}
    fields = getattr(found, "__dataclass_fields__", None)
    if fields:
        return [_bytes(getattr(found, name)) for name in fields]
    return np.asarray(found).tobytes() if hasattr(found, "shape") else found


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=extreme(
                f"flipped bits, {name}",
                given="one bit in each of 80 bytes, half of them in the header",
                expected="refused, or the same content",
            ),
        )
        for name in CHECKED
    ],
)
def test_a_flipped_bit_never_changes_what_is_read(name, tmp_path, got):
    reader, rng = READERS[name], small.rng()
    whole = good(reader, tmp_path / "g")
    file, same = tmp_path / "g" / reader.name, _same(name)
    expected, refused = same(file), 0
    places = [*rng.integers(min(300, len(whole)), size=40), *rng.integers(len(whole), size=40)]
    for at in places:
        content = bytearray(whole)
        content[at] ^= 1 << int(rng.integers(8))
        file.write_bytes(content)
        try:
            assert same(file) == expected, at
        except (UserError, KeyError):
            refused += 1
    got(f"{refused} refused, {len(places) - refused} harmless")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=extreme(
                f"truncated, {name}",
                given="0 and 1 bytes, the header but one, the header, half, all but one",
                expected="each refused",
            ),
        )
        for name in (*CHECKED, "PLY", "frame set", "camera", "display", "scene")
    ],
)
def test_a_truncated_file_is_refused(name, tmp_path, got):
    reader = READERS[name]
    whole = good(reader, tmp_path / "g").rstrip()
    header = {"PLY": whole.find(b"end_header") + 11, "frame": 500, "EXR": 330}.get(name, 8)
    lengths = sorted({0, 1, header - 1, header, len(whole) // 2, len(whole) - 1})
    for length in lengths:
        (tmp_path / "g" / reader.name).write_bytes(whole[:length])
        with pytest.raises(reader.errors):
            reader.read(tmp_path / "g" / reader.name)
    got(f"{len(lengths)} of {len(lengths)} refused")


@extreme(
    "damaged references",
    given="the reference of an evaluation cut off, zeroed, with a flipped bit, of another size",
    expected="made again, once",
)
def test_a_damaged_reference_is_made_again(tmp_path, got):
    file, made = tmp_path / "reference-0.exr", []
    image = small.rng().uniform(size=(6, 8, 3)).astype(np.float32)

    def make() -> Reference:
        made.append(1)
        return Reference(image, (image + 1, image + 2), image[..., 0])

    def is_whole() -> bool:
        found = stored_reference(file, make, (8, 6))
        return np.array_equal(found.radiance, image) and np.array_equal(found.halves[1], image + 2)

    assert is_whole()
    whole = file.read_bytes()
    flipped = bytearray(whole)
    flipped[-30] ^= 4
    smaller = lambda: Reference(image[:4], (image[:4], image[:4]), image[:4, :, 0])  # noqa: E731
    stored_reference(tmp_path / "other.exr", smaller)
    other = (tmp_path / "other.exr").read_bytes()
    damages = (b"", whole[:100], whole[:-1], bytes(len(whole)), bytes(flipped), other)
    for number, content in enumerate(damages, 2):
        file.write_bytes(content)
        for _ in range(2):
            assert is_whole()
        assert len(made) == number
    got(f"{len(damages)} of {len(damages)} made again")


def test_a_journal_of_an_earlier_version_is_read(tmp_path):
    """Without a checksum."""
    (tmp_path / "j.json").write_text(json.dumps({"identity": IDENTITY, "results": {"first": 0.5}}))
    assert Journal(tmp_path / "j.json", IDENTITY)["first"] == 0.5
