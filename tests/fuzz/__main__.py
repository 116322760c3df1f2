"""Tries the readers with many changed files: `python -m tests.fuzz COUNT SEED [READER ...]`."""

from __future__ import annotations

import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from types import FrameType

import hybrid  # noqa: F401  (finds LLVM before Dr.Jit looks for one)
from tests.fuzz.mutations import mutations
from tests.fuzz.readers import READERS, Reader, good, outcome

# A file that takes longer is taken for one that hangs.
_LONGEST_S = 10


def _hangs(number: int, frame: FrameType | None) -> None:
    raise TimeoutError("hangs")


def _tried(reader: Reader, folder: Path, count: int, seed: int) -> str:
    """What came of the files of one reader; those that did harm are printed with their number."""
    content, taken, bad, begin = good(reader, folder), 0, 0, time.monotonic()
    for number, changed in enumerate(mutations(content, count, seed)):
        signal.alarm(_LONGEST_S)
        try:
            taken += outcome(reader, folder, changed)
        except Exception:
            bad += 1
            print(f"  {number}: {traceback.format_exc().splitlines()[-1][:200]}")
        finally:
            signal.alarm(0)
    return f"{taken} read, {count - taken - bad} refused, {bad} bad in {time.monotonic() - begin:.0f} s"


def main() -> None:
    count, seed, *names = sys.argv[1:]
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGALRM, _hangs)
    for name in names or READERS:
        with tempfile.TemporaryDirectory() as folder:
            print(f"{name}: {_tried(READERS[name], Path(folder) / 'f', int(count), int(seed))}", flush=True)


if __name__ == "__main__":
    main()
