"""Masks on the wire: what comes out is what went in, and anything else is refused within bounds."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid.window.remote.protocol import decoded_mask as decoded
from hybrid.window.remote.protocol import encoded_mask as encoded


@st.composite
def pairs(draw) -> tuple[np.ndarray, np.ndarray]:
    """Two masks of one size, which differ in few or many places."""
    size = draw(st.integers(0, 40_000))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    base = rng.random(size) < 0.5
    share = draw(st.sampled_from([0.0, 1e-4, 1e-2, 0.5, 1.0]))
    return base, base ^ (rng.random(size) < share)


@given(pairs())
def test_a_mask_comes_back(pair):
    base, split = pair
    assert np.array_equal(decoded(encoded(split, base), base), split)


@given(st.lists(st.sampled_from([0, 127, 128, 16_383, 16_384, 2_097_151, 2_097_152]), max_size=4))
def test_gaps_of_every_length_come_back(gaps):
    at = np.cumsum([gap + 1 for gap in gaps], dtype=np.int64) - 1
    split = np.zeros(1 + int(at[-1]) if len(at) else 0, bool)
    split[at] = True
    base = np.zeros_like(split)
    assert np.array_equal(decoded(encoded(split, base), base), split)


@given(st.binary(max_size=64), st.booleans())
def test_any_bytes_make_a_mask_or_are_refused(content, deflated):
    base = np.zeros(1000, bool)
    try:
        found = decoded(zlib.compress(content) if deflated else content, base)
    except ValueError:
        return
    assert found.shape == base.shape


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"nothing of the kind", "cannot be inflated"),
        (zlib.compress(bytes([0])) + b"more", "does not end"),
        (zlib.compress(bytes([0] * 12)), "mask of node 11"),
        (zlib.compress(bytes([1, 128])), "a number that does not end"),
        (zlib.compress(bytes([128] * 4 + [1])), "a number that does not end"),
        (zlib.compress(bytes([0]))[:-3], "does not end"),
        # A million times as much as it takes.
        (zlib.compress(bytes(10_000_000)), "does not end"),
    ],
)
def test_what_is_no_mask_is_refused(content, said):
    with pytest.raises(ValueError, match=said):
        decoded(content, np.zeros(10, bool))
