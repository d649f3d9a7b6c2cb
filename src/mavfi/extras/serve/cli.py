"""`mavfi serve`: campaigns as local pages."""

import secrets
import socket
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli.console import counted
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, not_installed
from mavfi.files import is_dir

PORT = 8321
_LARGEST_PORT = 65_535
_PATIENCE_S = 1
"""Wall time that requests have to end after Ctrl-C (s)."""


def serve(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="A ledger, or a folder with ledgers in it.")],
    port: Annotated[int, typer.Option(help="Port on this machine; 0 = any that is free.")] = PORT,
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Serve campaigns as local pages: headlines, tables, figures, runs; a click on a run flies it again.

    Only this machine can open them, by the address that is printed. Ledgers are only read; campaigns that are running
    are shown as they go on. Ctrl-C ends it.

    Example: [bold]mavfi serve out --open[/bold]
    """
    if not 0 <= port <= _LARGEST_PORT:
        raise BadInputError(f"--port: {port}: allowed: 0 to {_LARGEST_PORT}")
    if not is_dir(directory):
        raise BadInputError(f"{directory}: is no folder; allowed: a ledger, or a folder with ledgers in it")
    try:
        import uvicorn

        from mavfi.extras.serve.app import HOST, application
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn"):
            raise
        raise not_installed("mavfi serve", error.name, "serve") from None
    from mavfi.extras.serve.flights import Flights
    from mavfi.extras.serve.ledgers import find_ledgers

    token = secrets.token_urlsafe(16)
    flights = Flights()
    app = application(directory, token, flights)
    listening = _listen(HOST, port)
    address = f"http://{HOST}:{listening.getsockname()[1]}/?token={token}"
    typer.echo(f"{counted(len(find_ledgers(directory)), 'campaign')} in {directory}, until Ctrl-C, at\n{address}")
    if open_browser:
        webbrowser.open(address)
    config = uvicorn.Config(
        app, log_level="warning", access_log=False, lifespan="off", timeout_graceful_shutdown=_PATIENCE_S
    )
    with stoppable("Stopped."):
        try:
            uvicorn.Server(config).run(sockets=[listening])
        finally:
            flights.close()


def _listen(host: str, port: int) -> socket.socket:
    """A socket that accepts connections of this machine."""
    listening = socket.socket()
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        raise BadInputError(f"--port: {port}: {error.strerror}; allowed: another one, or 0 for any free one") from None
    listening.listen()
    return listening
