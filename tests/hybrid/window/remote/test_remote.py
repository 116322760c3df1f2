"""A client and a server on this machine: cuts, the cache, reconnection, and the picture that is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from hybrid.base.cache_folder import home
from hybrid.base.progress import no_progress
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.splat_renderer import SplatRenderer
from hybrid.window.messages import Request, Server, ShownView
from hybrid.window.remote.protocol import ViewMessage
from hybrid.window.remote.server import ViewCuts, with_hierarchy
from hybrid.window.remote.source import RemoteSource, prepared_remote
from tests.hybrid.window.fakes import moved
from tests.hybrid.window.remote.conftest import (
    ACUITY,
    TOKEN,
    drawn_leaves,
    settings,
    shown_at_last,
    until,
)

DISPLAY = DISPLAYS["desktop"]


def current(remote):
    """Waits for the cut of the view that was asked for last."""
    until(remote, lambda: remote.is_current)
    return remote.cut


def test_the_cut_is_the_one_that_the_server_finds_for_the_view(serve, forest, camera):
    cuts = ViewCuts(with_hierarchy(forest), settings(20.0))
    with serve(level=20.0) as served:
        remote = served.link()
        before, sizes = None, []
        for step in range(5):
            view = camera.moved_right(0.2 * step), Gaze(0.2 * step, 0.5), DISPLAY
            remote.look(*view)
            cut = current(remote)
            expected, level = cuts.split(ViewMessage(1, 0, *view), before)
            assert np.array_equal(cut.split, expected)
            assert cut.level == level == 20.0
            assert (drawn_leaves(remote) == 1).all()
            before = expected
            sizes.append(np.count_nonzero(expected))
        assert len(set(sizes)) > 1
        remote.close()
    assert served.server.facts["masks"] == 5
    assert served.server.facts["faults"] == 0


def test_a_limit_holds_all_around(serve, camera):
    with serve(most=50) as served:
        remote = served.link()
        remote.look(camera, Gaze(), DISPLAY)
        cut = current(remote)
        assert np.count_nonzero(remote.tree.drawn(cut.split)) == 50
        assert cut.level > 1
        remote.close()


def test_the_forest_is_sent_once(serve, camera):
    with serve() as served:
        first = served.link()
        first.close()
        (file,) = (home() / "remote").iterdir()
        sent = file.read_bytes()
        stamp = file.stat().st_mtime_ns
        served.link().close()
        assert file.stat().st_mtime_ns == stamp
        # One that is damaged is sent again.
        file.write_bytes(sent[:-1] + bytes([sent[-1] ^ 1]))
        third = served.link()
        assert file.read_bytes() == sent
        assert third.forest.counts == first.forest.counts
        third.close()


def test_a_lost_connection_is_made_again(serve, camera):
    with serve() as served:
        remote = served.link()
        remote.look(camera, Gaze(), DISPLAY)
        before = current(remote)
        source = RemoteSource(remote)
        request = Request(FrameSettings(camera=camera))
    until(remote, lambda: remote.trouble)
    shown = source.show(request, quick=True)
    assert shown.notice.startswith("not connected: ")
    assert "\n" not in shown.notice
    assert remote.cut is before
    assert not shown.finished
    with serve(port=served.port):
        until(remote, lambda: not remote.trouble)
        other = Request(FrameSettings(camera=camera.moved_right(1)))
        shown = shown_at_last(source, other)
        assert shown.notice == ""
        assert remote.cut.sequence > before.sequence
        remote.close()


def test_another_forest_is_not_mixed_with_the_one_that_is_there(serve, forest, camera):
    with serve() as served:
        remote = served.link()
    other = replace(forest, trained_focal=2 * forest.trained_focal)
    with serve(port=served.port, given=other):
        until(remote, lambda: "another forest" in remote.trouble)
        remote.close()


def test_the_picture_is_that_of_the_local_cut(serve, forest, camera):
    """To the bit: the same nodes, on the same way to their parents."""
    asked = FrameSettings(camera=camera, gaze=(0.3, 0.6))
    with serve(level=4.0) as served:
        source = RemoteSource(served.link())
        shown = shown_at_last(source, Request(asked))
        source.close()
    own = with_hierarchy(forest)
    local, cuts = SplatRenderer(own), ViewCuts(own, settings(4.0))
    split, level = cuts.split(ViewMessage(1, 0, camera, asked.gaze, asked.display), None)
    local.hold_cut(cuts.tree.drawn(split))
    expected = local.frame(replace(asked, level=level)).composite
    assert np.array_equal(shown.frame.composite, expected)
    # What `level` draws without a server differs where a level changes on the way up a tree.
    free = SplatRenderer(own).frame(replace(asked, level=level, acuity_model=ACUITY))
    assert np.abs(free.composite - expected).mean() < 0.02 * free.composite.mean()


# Not both at once, the one against the other: only at one depth does nothing move then.
@pytest.mark.parametrize(("right", "degrees"), [(0.05, 0.0), (0.0, 3.0)])
def test_a_late_frame_comes_closer_to_what_is_seen_now(serve, camera, right, degrees):
    newest = moved(camera, 4.0 * right, degrees)
    with serve() as served:
        source = RemoteSource(served.link())
        late, expected = (
            shown_at_last(source, Request(FrameSettings(camera=view))).image.astype(float)
            for view in (camera, newest)
        )
        shown = source.show(Request(FrameSettings(camera=camera)), quick=True)
        warped = source.warped(shown, newest)
        assert np.mean((warped.image - expected) ** 2) < 0.5 * np.mean((late - expected) ** 2)
        source.close()


def test_views_that_need_paths_show_the_splats(serve, camera, tmp_path):
    with serve() as served:
        source = RemoteSource(served.link())
        ready = source.ready()
        assert (ready.name, ready.camera, ready.distance, ready.layers) == ("overlap", camera, 4.0, 2)
        for view in ShownView:
            shown = source.show(Request(FrameSettings(camera=camera), view), quick=True)
            assert shown.image.shape == (180, 320, 3)
        source.save(tmp_path / "shown.png")
        assert sorted(path.suffix for path in tmp_path.iterdir()) == [".exr", ".png"]
        source.close()


@pytest.mark.parametrize(
    ("address", "token", "said"),
    [
        ("http://localhost:{}", TOKEN, "must begin with wss://"),
        ("ws://localhost:{}", "wrong", "refuses the token"),
        ("ws://localhost:{}", "w\u00f6rong", "token"),
        ("wss://localhost:{}", TOKEN, "wss://"),
        ("ws://localhost:1", TOKEN, "refused|Connect"),
        ("ws://", TOKEN, "ws://: "),
    ],
)
def test_a_server_that_cannot_be_used_is_one_line(serve, address, token, said):
    with serve() as served, pytest.raises(UserError, match=said) as caught:
        prepared_remote(Server(address.format(served.port), token), "llvm", no_progress)
    assert "\n" not in str(caught.value)


def test_closing_the_window_ends_the_wait(serve):
    def closed(done: int, total: int, label: str) -> None:
        raise KeyboardInterrupt

    # Nothing answers there before the handshake's time is over.
    import socket

    with socket.create_server(("localhost", 0)) as silent:
        port = silent.getsockname()[1]
        with pytest.raises(KeyboardInterrupt):
            prepared_remote(Server(f"ws://localhost:{port}", TOKEN), "llvm", closed)
