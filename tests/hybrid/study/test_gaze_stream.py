"""The gaze of an eye tracker that streams it: here one of this process."""

import time
import uuid

import pytest

from compose.base.errors import UserError
from hybrid.study.gaze_stream import LabStream

pylsl = pytest.importorskip("pylsl", reason="gaze streams need pylsl", exc_type=(ImportError, RuntimeError))


@pytest.fixture
def outlet():
    info = pylsl.StreamInfo("tests", "Gaze", 2, 100, pylsl.cf_float32, uuid.uuid4().hex)
    made = pylsl.StreamOutlet(info)
    if not pylsl.resolve_byprop("source_id", info.source_id(), 1, 5.0):
        pytest.skip("this machine's network carries no streams")
    return made


def test_gazes_of_the_last_seconds_are_known(outlet):
    stream = LabStream()
    deadline = time.monotonic() + 20
    # The first samples may be sent before the stream is open.
    while not stream.last(60.0) and time.monotonic() < deadline:
        outlet.push_sample([0.25, 0.75])
        time.sleep(0.01)
    ago, x, y = stream.last(60.0)[-1]
    assert (x, y) == (0.25, 0.75)
    assert 0 <= ago < 60
    assert stream.last(0.0) == []
    stream.close()


def test_without_a_stream_it_says_what_to_start():
    if pylsl.resolve_byprop("type", "Gaze", 1, 0.2):
        pytest.skip("another program streams gaze here")
    with pytest.raises(UserError, match="start the eye tracker"):
        LabStream(looked_for=0.2)
