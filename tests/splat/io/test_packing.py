"""Tensors that are packed come back; what does not unpack as declared is refused."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
import torch

from splat.io import tensors as packing
from splat.io.tensors import packed, unpacked

TENSORS = {
    "half": torch.randn(3, 5, generator=torch.Generator().manual_seed(1)).half(),
    "single": torch.tensor([float("nan"), -0.0, 1e-45, float("inf")]),
    "double": torch.tensor(3.5, dtype=torch.float64),
    "truth": torch.tensor([True, False, True]),
    "bytes": torch.arange(256).to(torch.uint8),
    "short": torch.tensor([[-32768], [32767]], dtype=torch.int16),
    "int": torch.arange(7, dtype=torch.int32)[::2],
    "long": torch.tensor([2**62, -1]),
    "none": torch.zeros(0, 3, 2),
}


def test_every_bit_comes_back():
    content, kinds = packed(TENSORS)
    found = unpacked(content, kinds)
    assert found.keys() == TENSORS.keys()
    for name, expected in TENSORS.items():
        assert (found[name].dtype, found[name].shape) == (expected.dtype, expected.shape), name
        assert found[name].numpy().tobytes() == expected.contiguous().numpy().tobytes(), name


def test_small_numbers_take_few_bytes():
    """Their upper bytes are 0, and lie side by side."""
    values = torch.randint(0, 256, (10_000,), generator=torch.Generator().manual_seed(2), dtype=torch.int32)
    assert packed({"a": values})[0]["a"].numel() < 10_200


def _bytes(content: bytes) -> torch.Tensor:
    return torch.from_numpy(np.frombuffer(content, np.uint8).copy())


@pytest.mark.parametrize(
    ("content", "kind", "said"),
    [
        (zlib.compress(bytes(8)), ["float32", [3]], "does not unpack to 12 bytes"),
        (zlib.compress(bytes(16)), ["float32", [3]], "does not unpack to 12 bytes"),
        (zlib.compress(bytes(12))[:-3], ["float32", [3]], "does not unpack to 12 bytes"),
        (b"no stream", ["float32", [3]], "cannot be unpacked"),
        (b"", ["float32", [0]], "does not unpack to 0 bytes"),
        (zlib.compress(bytes(12)), ["complex64", [1]], "type or shape that does not exist"),
        (zlib.compress(bytes(12)), ["float32", [-3, -1]], "type or shape that does not exist"),
        (zlib.compress(bytes(12)), ["float32", [2**50]], "type or shape that does not exist"),
        (zlib.compress(bytes(12)), ["float32", 3], "type or shape that does not exist"),
        (zlib.compress(bytes(12)), [["float32"], [3]], "type or shape that does not exist"),
        (zlib.compress(bytes(12)), "float32", "has no type and shape"),
        (zlib.compress(bytes(12)), ["float32", [2**30, 2**30]], "bytes; at most"),
    ],
)
def test_what_does_not_unpack_is_refused(content, kind, said):
    with pytest.raises(ValueError, match=said):
        unpacked({"a": _bytes(content)}, {"a": kind})


def test_missing_kinds_and_other_types_are_refused():
    content, kinds = packed({"a": torch.ones(2)})
    with pytest.raises(ValueError, match="are missing"):
        unpacked(content, None)
    with pytest.raises(KeyError):
        unpacked(content, {})
    with pytest.raises(ValueError, match="expected packed bytes"):
        unpacked({"a": content["a"].int()}, kinds)


def test_a_few_bytes_do_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr(packing, "_ALWAYS", 1000)
    content, kinds = packed({"a": torch.zeros(100_000)})
    with pytest.raises(ValueError, match="400,000 bytes; at most"):
        unpacked(content, kinds)
