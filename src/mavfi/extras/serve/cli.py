"""`mavfi serve`: campaigns as local pages."""

import secrets
import socket
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli.console import counted
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError
from mavfi.files import is_dir

HELP_PANEL = "Campaigns"
PORT = 8321
_LARGEST_PORT = 65_535
_PATIENCE_S = 1
"""Wall time that requests have to end after Ctrl-C (s)."""


def serve(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="A ledger, or a folder with ledgers in it.")],
    port: Annotated[int, typer.Option(help="Port on this machine; 0 = any that is free.")] = PORT,
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Serve campaigns as local pages; a click flies a run again.

    They have headlines, tables, figures and runs. Only this machine can open them, by the address that is printed.
    Ledgers are only read; campaigns that are running are shown as they go on. Ctrl-C ends it.

    Example: [bold]mavfi serve out --open[/bold]
    """
    if not 0 <= port <= _LARGEST_PORT:
        raise BadInputError(f"--port: {port}: allowed: 0 to {_LARGEST_PORT}")
    if not is_dir(directory):
        raise BadInputError(f"{directory}: is no folder; allowed: a ledger, or a folder with ledgers in it")
    import uvicorn

    from mavfi.extras.serve.app import HOST, application
    from mavfi.extras.serve.flights import RequestedFlights
    from mavfi.extras.serve.ledgers import find_ledgers
    from mavfi.extras.serve.server import Server

    token = secrets.token_urlsafe(16)
    flights = RequestedFlights()
    app = application(directory, token, flights)
    listening = _listen(HOST, port)
    address = f"http://{HOST}:{listening.getsockname()[1]}/?token={token}"
    typer.echo(f"{counted(len(find_ledgers(directory)), 'campaign')} in {directory}, until Ctrl-C, at\n{address}")
    if open_browser:
        webbrowser.open(address)
    # the application itself prints what fails; uvicorn would add the requests that Ctrl-C cuts short
    config = uvicorn.Config(app, log_level="critical", lifespan="off", timeout_graceful_shutdown=_PATIENCE_S)
    with stoppable("Stopped."):
        Server(config, flights).run(sockets=[listening])


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
