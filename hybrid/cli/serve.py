"""`hybrid serve`: a server that decides what clients draw."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
from pathlib import Path
from typing import Annotated

from compose.base.errors import UserError, reading
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import DEFAULTS, FrameSettings

# Of a token's file, and of the token.
_MOST_BYTES, _LEAST_CHARACTERS = 4096, 16

TokenFile = Annotated[
    Path | None, o.network(metavar="FILE", help="File with the token that the server asks clients for.")
]


def serve(
    scene: o.SceneName,
    forest: o.ForestFile = None,
    host: Annotated[str, o.network(help="Name or address to listen on.")] = "127.0.0.1",
    port: Annotated[int, o.network(help="Port to listen on; 0 takes a free one.", min=0, max=65_535)] = 8765,
    certificate: Annotated[
        Path | None, o.network(metavar="PEM", help="Certificate for TLS, with those that it is signed with.")
    ] = None,
    key: Annotated[Path | None, o.network(metavar="PEM", help="Key of the certificate.")] = None,
    insecure: Annotated[
        bool,
        o.network("--insecure", help="Listen without TLS beyond this machine, for all to read the token."),
    ] = False,
    token_file: TokenFile = None,
    clients: Annotated[int, o.network(help="Clients at a time.", min=1, max=10_000)] = 16,
    rate: Annotated[
        float,
        o.network(help="Views per second of each client.", min=1, max=1000, callback=o.finite),
    ] = 120.0,
    discs: Annotated[
        int,
        o.network(
            help="Clients at a time whose discs are path-traced here; others see splats alone.", min=0, max=16
        ),
    ] = 1,
    level: o.Level = None,
    gaussians: o.MostGaussians = None,
    acuity_model: o.AcuityModelName = DEFAULTS.acuity_model,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Tell clients which Gaussians to draw for what they look at, and trace discs, until interrupted."""
    from hybrid.window.remote.server import Limits, Listening, ViewServer, is_loopback, tls_context

    if (certificate is None) != (key is None):
        raise UserError("--certificate, --key: TLS takes both")
    tls = None if certificate is None or key is None else tls_context(certificate, key)
    if tls is None and not insecure and not is_loopback(host):
        raise UserError(f"--host {host}: anybody could read the token; give --certificate and --key")
    settings = FrameSettings(
        level=1.0 if level is None else level, gaussians=gaussians, acuity_model=acuity_model
    )
    token = secrets.token_urlsafe(32) if token_file is None else read_token(token_file)
    o.select(backend)
    from hybrid.preparation.preparation import found_forest, with_forest
    from hybrid.render.irradiance import cache_for

    loaded, file = found_forest(o.loaded_scene(scene, None, thin_glass, sensor), forest, progress_bar)
    if file is None:
        raise UserError(f"{scene}: there is no forest yet; run hybrid prepare {scene} first")
    loaded, found = with_forest(loaded, file, progress_bar)
    distance = loaded.surfaces().median_distance(loaded.camera)
    if discs:
        cache_for(loaded, progress_bar)
    server = ViewServer(
        found,
        (loaded.camera, distance if 0 < distance < float("inf") else 1.0),
        settings,
        token,
        Limits(clients, rate, discs=discs),
        (loaded, found) if discs else None,
    )

    def announce(port: int) -> None:
        print(f"{'wss' if tls else 'ws'}://{host}:{port} shows {loaded.name} to up to {clients} clients")
        if token_file is None:
            print(f"token: {token}", flush=True)

    # As Ctrl-C: what runs services ends them so.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(server.run(Listening(host, port, tls), announce))
    return server.facts


def read_token(file: Path) -> str:
    """The token in a file; UserError if it is missing, too short to be one, or not plain text."""
    with reading(file), file.open("rb") as opened:
        token = opened.read(_MOST_BYTES).decode("ascii").strip()
    if len(token) < _LEAST_CHARACTERS or not token.isprintable() or " " in token:
        raise UserError(f"{file}: a token is one word of at least {_LEAST_CHARACTERS} characters")
    return token
