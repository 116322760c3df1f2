"""`hybrid serve`, and `hybrid demo --server`: what reaches server and window, and what is refused."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("PySide6", reason="the window requires PySide6")
from hybrid.window import main_window
from hybrid.window import qt_check as qt
from hybrid.window.messages import Server
from hybrid.window.remote import source
from hybrid.window.remote.client import Remote
from tests.hybrid.command import run

TOKEN = "sixteen-characters-or-more"


@pytest.fixture
def token(tmp_path) -> Path:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    return file


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_server_serves_until_it_is_interrupted(made, tmp_path, end):
    facts = tmp_path / "facts.json"
    command = [sys.executable, "-m", "hybrid.cli.main", "serve", "cornell", "--forest", made / "box.forest"]
    command += ["--port", 0, "--json", facts]
    words = list(map(str, command))
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        address = re.match(r"ws://127\.0\.0\.1:\d+", process.stdout.readline())
        assert address is not None
        said = process.stdout.readline().removeprefix("token: ").strip()
        remote = Remote(Server(address[0], said))
        remote.wait(lambda done, total, label: None)
        assert remote.welcome.scene == "cornell"
        remote.close()
        process.send_signal(end)
        rest = process.stdout.read()
    assert process.returncode == 0
    # The token is printed once.
    assert said not in rest
    assert len(said) >= 16
    assert json.loads(facts.read_text())["clients"] == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--host", "0.0.0.0"], "--host 0.0.0.0: anybody could read the token"),
        (["--host", "no.such.host.invalid"], "--host no.such.host.invalid: anybody"),
        (["--certificate", "a.pem"], "TLS takes both"),
        (["--key", "a.pem"], "TLS takes both"),
        (["--certificate", "a.pem", "--key", "b.pem"], "a.pem, b.pem: not a certificate and its key"),
        (["--token-file", "missing"], "missing: cannot be read"),
        (["--token-file", "short"], "short: a token is one word of at least 16 characters"),
        (["--token-file", "binary"], "binary: cannot be read"),
        (["--level", "0"], "level 0"),
        ([], "there is no forest yet; run hybrid prepare cornell first"),
    ],
)
def test_what_cannot_be_served_is_one_line(monkeypatch, tmp_path, capsys, own_home, options, said):
    monkeypatch.chdir(tmp_path)
    Path("short").write_text("short")
    Path("binary").write_bytes(bytes(range(256)))
    assert run(monkeypatch, "serve", "cornell", *options) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert said in error


def test_the_server_reaches_the_window(monkeypatch, token, tmp_path):
    shown, asked = [], []
    monkeypatch.setattr(qt, "window_problem", lambda: None)
    monkeypatch.setattr(main_window, "run_window", shown.append)
    monkeypatch.setattr(source, "prepared_remote", lambda *given: asked.append(given))
    authority = tmp_path / "ca.pem"
    options = ["--server", "wss://host:1", "--token-file", token, "--ca", authority, "--out", tmp_path]
    assert run(monkeypatch, "demo", *options) == 0
    (viewer,) = shown
    viewer.thread._prepare(lambda done, total, label: None)
    assert asked[0][:2] == (Server("wss://host:1", TOKEN, authority), "auto")
    assert TOKEN not in repr(asked)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "SCENE, --server: name one of them"),
        (["room", "--server", "wss://host:1"], "SCENE, --server: name one of them"),
        (["room", "--token-file", "token"], "--token-file, --ca: are for --server"),
        (["--server", "wss://host:1"], "give --token-file"),
        (["--server", "wss://host:1", "--token-file", "token", "--target", "20"], "--target"),
    ],
)
def test_a_server_and_what_belongs_to_it_come_together(monkeypatch, token, capsys, options, said):
    monkeypatch.chdir(token.parent)
    assert run(monkeypatch, "demo", *options) == 2
    assert said in capsys.readouterr().err
