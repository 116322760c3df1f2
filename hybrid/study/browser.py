"""The canvas of a study in a web browser: a server for one page, on this machine and for its users only."""

from __future__ import annotations

import json
import re
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from compose.base.errors import UserError, file_inside, one_line
from compose.base.files import parse_json
from hybrid.base.loopback import ADDRESS, HEADERS, Visitors, listening
from hybrid.study.session import StudySession

# Of a reply: far more than the pointer's positions in a trial of minutes take.
_MOST_BYTES = 1 << 23
_FRAME = re.compile(r"/clips/(\w[\w.-]*/[0-9]{6}\.png)", re.ASCII)


def serve_study(session: StudySession, announce: Callable[[str], object], port: int = 0) -> None:
    """Serves a study to a browser on this machine until the page has got the last step.

    Args:
        announce: gets the address to open once it can be, with a new token that keeps others out.
        port: of 127.0.0.1; 0 takes a free one.

    Raises:
        UserError: the port cannot be taken.
        Exception: what the session raised, other than a UserError, which the page shows.
    """
    with listening(f"port {port}"):
        server = _Server(session, port)
    with server:
        announce(server.visitors.address(server.server_port))
        server.serve_forever(poll_interval=0.1)
    if server.failure is not None:
        raise server.failure


class _Server(ThreadingHTTPServer):
    def __init__(self, session: StudySession, port: int):
        super().__init__((ADDRESS, port), _Handler)
        self.session = session
        self.lock = threading.Lock()
        self.visitors = Visitors()
        self.page = Path(__file__).with_name("study.html").read_bytes()
        self.failure: BaseException | None = None

    def stop(self) -> None:
        """Ends `serve_forever`, from a thread of a request."""
        threading.Thread(target=self.shutdown, daemon=True).start()

    def handle_error(self, request: object, client_address: object) -> None:
        error = sys.exc_info()[1]
        # A page that was closed or reloaded is no failure.
        if not isinstance(error, ConnectionError | TimeoutError):
            self.failure = error
            self.stop()


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    # Seconds that a request may stall.
    timeout = 30

    def do_GET(self) -> None:
        path = self._path()
        if path == "/":
            self._send(200, self.server.page, "text/html; charset=utf-8")
        elif path == "/step":
            with self.server.lock:
                step = self.server.session.step
            self._send_step(step)
        elif path is not None:
            self._send_frame(path)

    def do_POST(self) -> None:
        path = self._path()
        if path is None:
            return
        if path != "/answer":
            return self._refuse(404, "there is no such address")
        session = self.server.session
        try:
            reply = self._reply()
            with self.server.lock:
                # A reply sent again after a lost connection must not count twice.
                if reply["step"] == session.step["id"]:
                    session.answer(reply)
                step = session.step
        except UserError as error:
            return self._refuse(400, one_line(error))
        self._send_step(step)

    def _path(self) -> str | None:
        """The path asked for; None, after an answer of 403, if it is not the page that asks."""
        path, _, query = self.path.partition("?")
        headers, port = self.headers, self.server.server_port
        if self.server.visitors.admits(query, headers.get("Host"), headers.get("Origin"), port):
            return path
        self._refuse(403, "open the address that the study printed")
        return None

    def _reply(self) -> dict[str, Any]:
        if self.headers.get_content_type() != "application/json":
            raise UserError("reply: must be application/json")
        length = self.headers.get("Content-Length", "")
        if not re.fullmatch("[0-9]{1,8}", length) or int(length) > _MOST_BYTES:
            raise UserError(f"reply: must state its length, of at most {_MOST_BYTES:,} bytes")
        try:
            reply = parse_json(self.rfile.read(int(length)).decode())
        except ValueError as error:
            raise UserError(f"reply: is not JSON ({one_line(error)})") from error
        if not isinstance(reply, dict) or type(reply.get("step")) is not int:
            raise UserError('reply: must be an object whose "step" is a whole number')
        return reply

    def _send_step(self, step: dict[str, Any]) -> None:
        self._send(200, json.dumps(step, allow_nan=False).encode(), "application/json")
        if step["kind"] == "end":
            self.server.stop()

    def _send_frame(self, path: str) -> None:
        found = _FRAME.fullmatch(path)
        try:
            if not found:
                raise ValueError
            content = file_inside(self.server.session.folder / "clips", found[1]).read_bytes()
        except (OSError, ValueError):
            return self._refuse(404, "there is no such frame")
        self._send(200, content, "image/png")

    def _refuse(self, status: int, line: str) -> None:
        self._send(status, line.encode(), "text/plain; charset=utf-8")

    def _send(self, status: int, content: bytes, content_type: str) -> None:
        self.send_response(status)
        for name, value in (*HEADERS.items(), ("Content-Type", content_type)):
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        pass
