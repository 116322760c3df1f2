"""A streamed disc: what the server traces, what the client shows of it now, and what either end refuses."""

from __future__ import annotations

import contextlib
import math
import threading
import time
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from compose.camera.camera import Camera, turned
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from compose.fovea.samples import Samples
from compose.fovea.warping import CELL, grid
from compose.image.colour import bytes_from_radiance, decibels, radiance_from_srgb
from hybrid.preparation.scene_plan import as_planned
from hybrid.render.disc_tracer import DiscRequest, DiscTracer
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.render.image_files import jpeg_bytes
from hybrid.render.splat_renderer import SplatRenderer
from hybrid.window.messages import Request, ShownView
from hybrid.window.remote import disc_tracing
from hybrid.window.remote import server as server_module
from hybrid.window.remote.disc_messages import (
    DISC,
    MOST_PIXELS,
    DiscMessage,
    DiscWanted,
    StreamedDisc,
    content_of,
)
from hybrid.window.remote.disc_tracing import DiscServer
from hybrid.window.remote.protocol import ViewMessage
from hybrid.window.remote.shown_disc import with_disc
from hybrid.window.remote.source import RemoteSource
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from tests.extremes import extreme
from tests.hybrid.window.remote.conftest import ACUITY, LONG, admitted, shown_at_last, until

DISPLAY = DISPLAYS["desktop"]
WANTED = DiscWanted(20.0, 15.0, 1)


@pytest.fixture(scope="session")
def traced(backend, made):
    """The Cornell box, and its forest."""
    return as_planned(load_scene("cornell")), load_forest(made / "box.forest")


@pytest.fixture(scope="session")
def box(traced) -> Camera:
    return traced[0].camera.resized(160, 120)


def psnr(image: np.ndarray, expected: np.ndarray) -> float:
    return decibels(float(np.mean((image.astype(float) - expected) ** 2)) / 255**2)


def refined(traced, settings: FrameSettings):
    """A frame with as many samples as a final disc has."""
    renderer, seed = LiveRenderer(*traced), 100
    frame = renderer.frame(replace(settings, acuity_model=ACUITY), seed)
    while frame.fovea.samples.mean_count() < 64:
        seed += 1
        frame = renderer.refined(frame, 8, seed, quick=False)
    return frame


def view(camera: Camera, gaze: Gaze, sequence: int = 1) -> ViewMessage:
    return ViewMessage(sequence, 0, camera, gaze, DISPLAY)


def next_message(server: DiscServer, newest: ViewMessage) -> DiscMessage:
    """The next disc of a view, after as many steps as it takes."""
    while (message := server.message(newest, WANTED)) is None:
        pass
    return message


def waiting(holds) -> None:
    """Waits for something that a server's thread brings about."""
    deadline = time.monotonic() + LONG
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(1e-3)


class TestTracing:
    """What a server makes of a view."""

    def test_the_square_shows_the_fovea_that_is_rendered_here(self, traced, box):
        gaze, server = Gaze(0.4, 0.6), DiscServer(*traced, ACUITY)
        first = message = next_message(server, view(box, gaze))
        assert (message.sequence, message.fov_a, message.final) == (1, 20, False)
        assert message.fov_b == pytest.approx(15)
        while not message.final:
            message = next_message(server, view(box, gaze))
        frame = refined(traced, replace(INTERACTIVE, gaze=gaze, fov_a=20, fov_b=15, camera=box))
        weights = frame.weight_image()
        rows, columns = (slice(start, start + message.side) for start in (message.top, message.left))
        inside = weights[rows, columns] > 0
        assert inside.sum() == (weights > 0).sum()
        expected = bytes_from_radiance(frame.of_disc(frame.fovea.radiance))[rows, columns][inside]
        found = [psnr(StreamedDisc.of(one, box, gaze).image[inside], expected) for one in (first, message)]
        assert found[1] > max(36, found[0] + 2)

    def test_depths_are_those_of_the_first_hits(self, traced, box):
        message = DiscServer(*traced, ACUITY).message(view(box, Gaze()), WANTED)
        disc = StreamedDisc.of(message, box, Gaze())
        depth = LiveRenderer(*traced).frame(replace(INTERACTIVE, camera=box, aovs=("depth",))).more["depth"]
        rows, columns = grid(disc.square)
        at = [
            first + CELL // 2 + CELL * np.arange(n)
            for first, n in ((message.top, rows), (message.left, columns))
        ]
        found = 1 / depth[np.ix_(*at)]
        # Within a step, but for cells at an edge of something.
        errors = np.abs(disc.nearness.reshape(rows, columns) - found)
        assert np.quantile(errors, 0.9) < found.max() / 128

    def test_a_view_that_stays_is_refined_until_it_is_good(self, traced, box):
        server, counts = DiscServer(*traced, ACUITY), []
        for number in range(1, 8):
            message = next_message(server, view(box, Gaze(), number))
            counts.append(message.spp)
            assert message.final == (number == 7)
        np.testing.assert_allclose(counts, [1, 2, 4, 8, 16, 32, 64])
        other = server.message(view(box, Gaze(0.6, 0.5), 8), WANTED)
        assert other is not None
        assert not other.final
        # What is known of it is shown at once, and better after a single sample.
        again = [next_message(server, view(box, Gaze(), number)) for number in (9, 10)]
        assert again[0].spp > 2
        assert again[1].spp == pytest.approx(again[0].spp + 1)
        server.forget()
        assert next_message(server, view(box, Gaze(), 11)).spp == 1

    def test_another_view_waits_for_one_sample_of_the_last_at_most(self, traced, box, monkeypatch):
        server, counts = DiscServer(*traced, ACUITY), []
        trace = DiscTracer.trace

        def counted(tracer: DiscTracer, request: DiscRequest, *more: object) -> Samples:
            counts.append(request.spp)
            return trace(tracer, request, *more)

        monkeypatch.setattr(DiscTracer, "trace", counted)
        messages = [server.message(view(box, Gaze()), WANTED) for _ in range(9)]
        shown = [message and message.spp for message in messages]
        assert shown == pytest.approx([1, 2, None, 4, None, None, None, 8, None])
        other = server.message(view(box, Gaze(0.8, 0.2), 2), WANTED)
        assert other is not None
        assert other.spp == 1
        assert counts == [1] * 10

    @extreme("a streamed disc beside the frame", given="gaze two frames away", expected="no disc")
    def test_beside_the_frame_there_is_none(self, traced, box, got):
        message = DiscServer(*traced, ACUITY).message(view(box, Gaze(3, 0.5)), WANTED)
        assert got(message.side) == 0
        assert message.final
        assert DiscMessage.unpacked(message.packed()) == message

    def test_a_disc_that_others_wait_for_is_smaller_where_paths_take_long(self, traced, box, monkeypatch):
        server = DiscServer(*traced, ACUITY)
        alone = server.message(view(box, Gaze()), WANTED)
        # As many seconds as paths, of which a power of two is traced.
        monkeypatch.setattr(disc_tracing, "_MOST_SECONDS", 700.0)
        server._pace = 1.0
        assert server.message(view(box, Gaze(0.4), 2), WANTED).side == alone.side
        server._pace = 1.0
        message = server.message(view(box, Gaze(0.5), 3), WANTED, others_wait=True)
        assert message.side == 2 * math.ceil(math.sqrt(512 / math.pi)) + 2
        assert message.fov_b / message.fov_a == pytest.approx(0.75)

    @extreme(
        "a streamed disc of everything",
        given="radius of 10,000 %, 16,777,216 samples",
        expected="at most 2^19 pixels",
    )
    def test_a_disc_of_everything_is_bounded(self, traced, box, got):
        message = DiscServer(*traced, ACUITY).message(view(box, Gaze()), DiscWanted(1e4, 5e3, 1 << 24))
        assert got(message.side**2) <= MOST_PIXELS
        assert message.fov_a < 1e4
        assert message.fov_b == pytest.approx(message.fov_a / 2)
        assert message.spp <= (1 << 19) / (160 * 120) + 1
        StreamedDisc.of(DiscMessage.unpacked(message.packed()), box, Gaze())


def plane(camera: Camera, depth: float) -> np.ndarray:
    """(H, W, 3) sRGB bytes: a pattern on the plane z = depth of the world, which may be inf."""
    rays = camera.rays(camera.pixel_centres())
    far = depth if np.isfinite(depth) else 1e7
    hits = camera.position + rays * ((far - camera.position[2]) / rays[:, 2])[:, None]
    x, y, _ = (hits / far).T
    bands = [0.5 + 0.4 * np.sin(20 * x + 1), 0.5 + 0.4 * np.sin(17 * y), 0.5 + 0.4 * np.sin(9 * (x + y))]
    return np.uint8(np.stack(bands, axis=1).reshape(camera.height, camera.width, 3) * 255 + 0.5)


def streamed(camera: Camera, gaze: Gaze, depth: float, side: int = 82) -> StreamedDisc:
    """A disc of the pattern as a server would have sent it, for a radius of 40 pixels."""
    left, top = (int(at) - side // 2 for at in gaze.pixel(camera.width, camera.height))
    where = DiscMessage(1, left, top, side, 4000 / camera.height, 3000 / camera.height, 4.0)
    square = camera.cropped(left, top, side, side)
    near = np.full(np.prod(grid(square)), 1 / depth, np.float32)
    content = content_of(plane(square, depth), near, final=True)
    return StreamedDisc.of(replace(where, **content), camera, gaze)


class TestShowing:
    """What a client shows of a disc that was traced for another view."""

    @pytest.fixture
    def start(self, camera) -> Camera:
        return replace(camera, world_to_camera=np.eye(4))

    @pytest.fixture
    def drawn(self, forest, camera):
        """Frames of splats."""
        renderer = SplatRenderer(forest)
        return lambda camera: renderer.frame(FrameSettings(camera=camera))

    @pytest.mark.parametrize(
        ("depth", "yaw", "move"),
        [(2.0, 0, (0, 0, 0)), (np.inf, 6, (0, 0, 0)), (2.0, 0, (0.2, 0.05, 0)), (2.0, 4, (-0.1, 0, 0.1))],
    )
    def test_it_lies_where_the_surface_is_now(self, start, drawn, depth, yaw, move):
        gaze = Gaze(0.5, 0.5)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned(np.eye(3), yaw, 0), move
        now = start.at(pose)
        before = drawn(now).composite.copy()
        frame = with_disc(drawn(now), streamed(start, gaze, depth))
        weights = frame.weight_image()
        inside = weights >= 1
        assert inside.sum() > 0.9 * np.pi * 30**2
        shown = bytes_from_radiance(frame.composite)
        assert psnr(shown[inside], plane(now, depth)[inside]) > 30
        # Around it, the splats; in the band, both.
        np.testing.assert_array_equal(frame.composite[weights == 0], before[weights == 0])
        band = (weights > 0) & ~inside
        both = before + weights[..., None] * (radiance_from_srgb(plane(now, depth) / 255) - before)
        assert psnr(shown[band], bytes_from_radiance(np.float32(both))[band]) > 28
        np.testing.assert_allclose(frame.periphery, before, atol=1e-6)
        # What was looked at is still at the centre.
        direction = start.rays(np.array([gaze.pixel(start.width, start.height)]))[0]
        point = direction * (depth / direction[2] if np.isfinite(depth) else 1e6)
        (place,), _ = now.project(point[None])
        np.testing.assert_allclose(frame.settings.gaze.pixel(now.width, now.height), place, atol=0.51)
        assert frame.fovea.samples.mean_count() == 4

    def test_what_was_not_traced_has_no_weight(self, start, drawn):
        """A viewer who steps back sees around the square."""
        pose = np.eye(4)
        pose[2, 3] = -2.0
        now = start.at(pose)
        frame = with_disc(drawn(now), streamed(start, Gaze(), 2.0))
        weights = frame.weight_image()
        assert weights.max() == 1
        # Half as large, at twice the distance.
        down, across = np.nonzero(weights)
        assert np.ptp(down) == pytest.approx(40, abs=2)
        assert np.ptp(across) == pytest.approx(40, abs=2)

    def test_one_that_cannot_be_seen_changes_nothing(self, start, drawn):
        back, aside, other = np.diag([-1.0, 1, -1, 1]), np.eye(4), start.resized(160, 90)
        aside[:3, :3] = turned(np.eye(3), 80, 0)
        for now in (start.at(back), start.at(aside), other):
            frame = drawn(now)
            assert with_disc(frame, streamed(start, Gaze(), 2.0)) is frame


class TestMessages:
    """What either end refuses."""

    @given(st.binary(max_size=80) | st.binary(min_size=21, max_size=21))
    def test_any_bytes_are_a_message_or_refused(self, content):
        for kind in (DiscWanted, DiscMessage):
            with contextlib.suppress(ValueError):
                kind.unpacked(content).packed()

    def test_what_is_wanted_comes_back(self):
        assert DiscWanted.unpacked(WANTED.packed()) == WANTED

    @pytest.mark.parametrize(
        ("wanted", "said"),
        [
            (DiscWanted(-1.0, 0.0, 1), "fov-a"),
            (DiscWanted(float("nan"), 0.0, 1), "fov-a"),
            (DiscWanted(10.0, 20.0, 1), "fov-b"),
            (DiscWanted(10.0, 5.0, 0), "samples per pixel"),
        ],
    )
    def test_what_nobody_can_want_is_refused(self, wanted, said):
        with pytest.raises(ValueError, match=said):
            DiscWanted.unpacked(wanted.packed())

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            ({"side": 60_000}, "at most"),
            ({"fov_b": 90.0}, "fov-b"),
            ({"fov_a": float("inf")}, "fov-a"),
            ({"spp": float("nan")}, "out of range"),
            ({"greatest": -1.0}, "out of range"),
            ({"greatest": 1e30}, "out of range"),
            ({"left": -(1 << 31)}, "out of range"),
            ({"top": 1 << 25}, "out of range"),
            ({"depths": b"junk"}, "inflated"),
            ({"depths": zlib.compress(bytes(3))}, "3 depths"),
            ({"side": 8}, "depths|picture"),
            ({"picture": b""}, "no JPEG"),
            ({"picture": jpeg_bytes(np.zeros((1, 5000, 3), np.uint8), 90)}, "5000 x 1"),
        ],
    )
    def test_a_disc_that_does_not_fit_is_refused(self, camera, change, said):
        message = replace(streamed(camera, Gaze(), 2.0).message, **change)
        with pytest.raises(ValueError, match=said) as caught:
            StreamedDisc.of(DiscMessage.unpacked(message.packed()), camera, Gaze())
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize(
        "change",
        [
            {"left": 1 << 24},
            {"top": -(1 << 24)},
            {"greatest": 1e6},
            {"fov_a": 1e300},
            {"fov_a": 0.0, "fov_b": 0.0},
        ],
    )
    def test_what_is_read_can_be_shown(self, forest, camera, change):
        """However little sense it makes."""
        message = replace(streamed(camera, Gaze(), 2.0).message, **change)
        disc = StreamedDisc.of(DiscMessage.unpacked(message.packed()), camera, Gaze())
        renderer = SplatRenderer(forest)
        for now in (camera, camera.moved_right(0.3), camera.moved_right(1e6)):
            frame = with_disc(renderer.frame(FrameSettings(camera=now)), disc)
            assert np.isfinite(frame.composite).all()

    def test_a_damaged_picture_is_refused_or_shown(self, camera):
        message = streamed(camera, Gaze(), 2.0).message
        for cut in range(0, len(message.picture), 97):
            damaged = replace(message, picture=message.picture[:cut])
            with contextlib.suppress(ValueError):
                StreamedDisc.of(damaged, camera, Gaze())


class TestStreaming:
    """Both ends together."""

    def test_the_window_shows_the_disc_and_refines_it(self, serve, traced, box, forest):
        with serve(traced=traced, given=traced[1]) as served:
            source = RemoteSource(served.link())
            request = Request(replace(INTERACTIVE, camera=box, fov_a=20, fov_b=15))
            shown = shown_at_last(source, request)
            assert shown.spp >= 64
            assert shown.frame.region.count == np.count_nonzero(shown.frame.weight_image() > 0)
            frame = refined(traced, request.settings)
            inside = frame.weight_image() >= 1
            assert psnr(shown.image[inside], bytes_from_radiance(frame.composite)[inside]) > 33
            # Another radius, with the mouse at rest.
            wider = Request(replace(request.settings, fov_a=30, fov_b=20))
            shown = shown_at_last(source, wider)
            assert shown.frame.settings.fov_a == 30
            without = source.show(replace(wider, view=ShownView.PERIPHERY), quick=True)
            assert (without.image != shown.image).any()
            # None, and it is gone.
            shown = shown_at_last(source, Request(replace(request.settings, fov_a=0, fov_b=0)))
            assert not shown.frame.region.count
            source.close()
        assert served.server.facts["faults"] == 0
        assert served.server.facts["discs"] > 10

    def test_another_disc_is_that_of_the_next_view(self, serve, camera):
        """Whoever asks for one, and says later where it looks, has one for that view."""
        none, found = DiscWanted(0.0, 0.0, 1), []
        with serve() as served, admitted(served) as connection:
            for sequence, wanted in enumerate((WANTED, none), 1):
                connection.send(wanted.packed())
                # The server is no longer busy with anything.
                time.sleep(0.1)
                connection.send(view(camera, Gaze(), sequence).packed())
                while len(found) < sequence:
                    message = connection.recv(timeout=LONG)
                    if message[0] == DISC:
                        found.append(DiscMessage.unpacked(message).sequence)
        assert found == [1, 2]

    def test_the_last_disc_is_the_last_one_of_its_view_alone(self, serve, camera):
        with serve() as served:
            remote = served.link()
            remote.want(WANTED)
            remote.look(camera, Gaze(), DISPLAY)
            until(remote, lambda: remote.disc_is_final)
            remote.look(camera, Gaze(0.6), DISPLAY)
            assert not remote.disc_is_final
            until(remote, lambda: remote.disc_is_final)
            remote.want(replace(WANTED, fov_a=30.0))
            assert not remote.disc_is_final
            until(remote, lambda: remote.disc_is_final)
            # Somewhere else and back, sooner than a disc of that can come.
            remote.look(camera, Gaze(0.7), DISPLAY)
            remote.look(camera, Gaze(0.6), DISPLAY)
            until(remote, lambda: remote.disc_is_final and remote.is_current)
            remote.close()

    def test_when_a_client_leaves_another_one_gets_its_disc(self, serve, traced, box):
        with serve(traced=traced, given=traced[1]) as served:
            first, second = served.link(), served.link()
            for number, (remote, has_disc) in enumerate(((first, True), (second, False))):
                remote.want(WANTED)
                remote.look(box, Gaze(0.4 + 0.1 * number, 0.5), DISPLAY)
                until(remote, lambda remote=remote: remote.disc or remote.disc_is_final)
                assert (remote.disc is not None) == has_disc
            first.close()
            gaze = 0.5
            while second.disc is None:
                gaze += 1e-3
                second.look(box, Gaze(gaze, 0.5), DISPLAY)
                until(second, lambda: second.is_current)
            second.close()

    @pytest.mark.parametrize(("waits", "first"), [(1e3, ["mask", "mask"]), (0.0, ["mask", "disc"])])
    def test_discs_wait_for_masks_of_all_clients_but_not_for_ever(
        self, serve, camera, monkeypatch, waits, first
    ):
        done, gate = [], threading.Event()

        class Disc:
            """Is traced at once."""

            def forget(self) -> None:
                pass

            def message(self, view: ViewMessage, *wanted: object) -> DiscMessage:
                done.append("disc")
                return DiscMessage(view.sequence)

        monkeypatch.setattr(server_module, "_DISC_WAITS", waits)
        with serve() as served:
            server = served.server
            server._discs.append(Disc())
            one, other = served.link(), served.link()
            one.want(WANTED)
            for remote in (one, other):
                remote.look(camera, Gaze(), DISPLAY)
                until(remote, lambda remote=remote: remote.is_current)
            until(one, lambda: one.disc_is_final)
            cut, jobs = server._cuts.split, server._worker._work_queue
            monkeypatch.setattr(server._cuts, "split", lambda *given: done.append("mask") or cut(*given))
            # Until another disc may follow, and until it has.
            time.sleep(0.1)
            done.clear()
            server._worker.submit(gate.wait)
            one.look(camera, Gaze(0.6, 0.5), DISPLAY)
            time.sleep(0.1)
            waiting(lambda: jobs.qsize() == (1 if waits else 2))
            other.look(camera, Gaze(0.6, 0.5), DISPLAY)
            waiting(lambda: jobs.qsize() == (2 if waits else 3))
            gate.set()
            waiting(lambda: "disc" in done)
            assert done[:2] == first
            one.close()
            other.close()

    def test_a_server_without_discs_says_so(self, serve, camera):
        with serve() as served:
            source = RemoteSource(served.link())
            shown = shown_at_last(source, Request(replace(INTERACTIVE, camera=camera)))
            assert not shown.frame.region.count
            source.close()
