"""Bad files, made of good ones by seeded random changes of bytes, numbers, names and structure."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

_NUMBER = re.compile(rb"-?\d+(\.\d+)?")
_TEXTS = (
    *(b"1e999", b"-1e308", b"NaN", b"Infinity", b"9" * 5000, b"-1", b"0", b"18446744073709551615", b"1e-320"),
    *(
        b"null",
        b"true",
        b"[]",
        b"{}",
        b'""',
        b'"x"',
        b"\0",
        b"\n",
        b'"',
        b"../../../etc/passwd",
        b"/dev/zero",
    ),
    *(b"[" * 3000, b'{"a":' * 3000, b"\xff\xfe", "ü\u2028".encode(), b"%n%s", b"<", b"&x;", b"$", b"\\ud800"),
)
_WORDS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7F800000, 0x7FC00000)


def mutations(content: bytes, count: int, seed: int) -> Iterator[bytes]:
    """`count` changed copies of a content; the same for the same seed."""
    rng = np.random.default_rng(seed)
    kinds = (_cut, _flipped, _numbers, _words, _texts, _repeated, _removed, _swapped)
    for _ in range(count):
        changed = content
        for _ in range(int(rng.integers(1, 4))):
            changed = kinds[int(rng.integers(len(kinds)))](changed, rng)
        yield changed


def _place(content: bytes, rng: np.random.Generator) -> int:
    """A random place, mostly in the first part, where headers are."""
    most = len(content) if rng.random() < 0.4 else min(len(content), 400)
    return int(rng.integers(most)) if most else 0


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(len(content) + 1))]


def _flipped(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        if changed:
            changed[_place(content, rng)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _numbers(content: bytes, rng: np.random.Generator) -> bytes:
    """A number in text replaced by another text."""
    found = list(_NUMBER.finditer(content))
    if not found:
        return content
    one = found[int(rng.integers(len(found)))]
    return content[: one.start()] + _TEXTS[int(rng.integers(len(_TEXTS)))] + content[one.end() :]


def _words(content: bytes, rng: np.random.Generator) -> bytes:
    """Four or eight bytes replaced by a word at the ends of what integers and floats hold."""
    at, size = _place(content, rng), int(rng.choice([4, 8]))
    word = _WORDS[int(rng.integers(len(_WORDS)))].to_bytes(size, "little")
    return content[:at] + word + content[at + size :]


def _texts(content: bytes, rng: np.random.Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + _TEXTS[int(rng.integers(len(_TEXTS)))] + content[at:]


def _repeated(content: bytes, rng: np.random.Generator) -> bytes:
    one, other = sorted(int(value) for value in rng.integers(len(content) + 1, size=2))
    return content[:other] + content[one:other] * int(rng.integers(1, 4)) + content[other:]


def _removed(content: bytes, rng: np.random.Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + content[at + int(rng.integers(1, 40)) :]


def _swapped(content: bytes, rng: np.random.Generator) -> bytes:
    """A quoted text replaced by another one of the file."""
    found = list(re.finditer(rb'"[^"]{1,80}"', content))
    if len(found) < 2:
        return content
    one, other = (found[int(index)] for index in rng.integers(len(found), size=2))
    return content[: one.start()] + other.group() + content[one.end() :]
