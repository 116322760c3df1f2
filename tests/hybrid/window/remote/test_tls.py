"""TLS with a certificate that signs itself."""

from __future__ import annotations

import shutil
import ssl
import subprocess
from pathlib import Path

import pytest

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from hybrid.window.messages import Server
from hybrid.window.remote.client import Remote
from hybrid.window.remote.server import tls_context
from tests.hybrid.window.remote.conftest import TOKEN, until


def certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """PEM files of a certificate for localhost, and of its key."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    made, key = folder / f"{name}.pem", folder / f"{name}.key"
    words = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 1 -subj /CN=localhost"
    names = "-addext subjectAltName=DNS:localhost"
    command = ["openssl", *words.split(), *names.split(), "-keyout", str(key), "-out", str(made)]
    subprocess.run(command, check=True, capture_output=True)
    return made, key


@pytest.fixture(scope="module")
def own(tmp_path_factory) -> tuple[Path, Path]:
    return certificate(tmp_path_factory.mktemp("own"), "own")


def test_a_certificate_that_the_client_knows_is_trusted(serve, own, camera):
    with serve(tls=tls_context(*own)) as served:
        assert served.address.startswith("wss://")
        remote = served.link(authority=own[0])
        remote.look(camera, Gaze(), DISPLAYS["desktop"])
        until(remote, lambda: remote.is_current)
        remote.close()


def test_a_certificate_of_somebody_else_is_refused(serve, own, tmp_path, log):
    other, _ = certificate(tmp_path, "other")
    with serve(tls=tls_context(*own)) as served:
        for authority in (other, None):
            with pytest.raises(UserError, match="certificate") as caught:
                served.link(authority=authority)
            assert "\n" not in str(caught.value)
        # Without TLS, nothing is said either.
        address = served.address.replace("wss", "ws")
        with pytest.raises(UserError):
            Remote(Server(address, TOKEN)).wait(lambda done, total, label: None)
        assert served.server.facts["clients"] == 0


def test_files_that_are_no_certificate_are_one_line(own, tmp_path):
    junk = tmp_path / "junk.pem"
    junk.write_text("nothing of the kind")
    for pair in ((junk, own[1]), (own[0], junk), (tmp_path / "missing", own[1]), (own[1], own[0])):
        with pytest.raises(UserError, match="certificate"):
            tls_context(*pair)
    with pytest.raises(UserError, match="certificate"):
        Remote(Server("wss://localhost:1", TOKEN, junk))
    assert tls_context(*own).minimum_version >= ssl.TLSVersion.TLSv1_2
