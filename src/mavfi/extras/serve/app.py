"""The application: pages of campaigns and flights on loopback, for the holder of a token, read-only."""

import asyncio
import secrets
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from mavfi.analysis.listing import partner
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.serve import pages
from mavfi.extras.serve.flights import FlownPage, RequestedFlights, RunKey
from mavfi.extras.serve.ledgers import ReadLedger, ServedLedger, find_ledgers

T = TypeVar("T")
HOST = "127.0.0.1"
"""The only address that is served."""
_NAMES = [HOST, "localhost"]
"""Host names of requests: a page of another site whose name is bound to loopback has another one."""
_WAITS = "mavfi-waits"
"""Header of requests whose page shows already that it waits; see reading.html.j2."""
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the first address contains the token
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class _TokenMiddleware(BaseHTTPMiddleware):
    """Refuses requests without the token, which the first address has; it moves to a cookie."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        super().__init__(app)
        self._token = token

    async def dispatch(self, request: Request, call_next: RequestResponseEndpoint) -> Response:
        # cookies of all ports of a host are sent to each of them
        cookie = f"mavfi-{request.url.port}"
        if self._is_token(request.query_params.get("token")):
            response: Response = RedirectResponse(str(request.url.remove_query_params("token")), 303)
            response.set_cookie(cookie, self._token, httponly=True, samesite="strict")
        elif self._is_token(request.cookies.get(cookie)):
            response = await call_next(request)
        else:
            response = PlainTextResponse("Forbidden: open the address that `mavfi serve` has printed.\n", 403)
        response.headers.update(_HEADERS)
        return response

    def _is_token(self, text: str | None) -> bool:
        return text is not None and secrets.compare_digest(text.encode(), self._token.encode())


@dataclass(frozen=True)
class _NamedLedger:
    """The ledger that a request names.

    Attributes:
        key: Its name on pages: its path relative to the served folder.
        ledger: The ledger.
    """

    key: str
    ledger: ServedLedger


class _Site:
    """Answers of the application.

    Args:
        folder: Folder with ledgers.
        flights: Flies runs.
    """

    def __init__(self, folder: Path, flights: RequestedFlights) -> None:
        self._folder = folder
        self._flights = flights
        self._ledgers: dict[str, ServedLedger] = {}

    def ledgers(self) -> dict[str, ServedLedger]:
        """The ledgers that are in the folder now, by name."""
        directories = find_ledgers(self._folder)
        self._ledgers = {
            key: self._ledgers.get(key) or ServedLedger(directory) for key, directory in directories.items()
        }
        return self._ledgers

    def _find(self, key: str) -> _NamedLedger:
        ledger = self._ledgers.get(key) or self.ledgers().get(key)
        if ledger is None:
            raise HTTPException(404, f"no campaign {key!r} in {self._folder}")
        return _NamedLedger(key, ledger)

    async def overview(self, request: Request) -> Response:
        """All campaigns, with the headline of each; that of the only one is its own page."""
        ledgers = await _in_thread(self.ledgers)
        if list(ledgers) == [""]:
            return RedirectResponse("/campaign/")
        return HTMLResponse(pages.overview(self._folder, list(ledgers)))

    async def row(self, request: Request) -> Response:
        """The row of a campaign in the overview."""
        named = self._find(request.path_params["key"])
        return HTMLResponse(await _in_thread(_row, named))

    async def campaign(self, request: Request) -> Response:
        """The page of a campaign; before its ledger is read, one that says so and asks again."""
        named = self._find(request.path_params["key"])
        if named.ledger.last_read is None and _WAITS not in request.headers:
            return HTMLResponse(pages.reading(self._folder, named.key))
        others = [key for key in await _in_thread(self.ledgers) if key != named.key]
        return HTMLResponse(await _in_thread(_campaign, self._folder, named, others))

    async def state(self, request: Request) -> Response:
        """Stamp and progress of a campaign, which its page asks for while it is open."""
        named = self._find(request.path_params["key"])
        return JSONResponse(await _in_thread(_state, named))

    async def flight(self, request: Request) -> Response:
        """The page of a run as JSON, after flying it; 422 = it cannot be flown, and why."""
        named = self._find(request.path_params["key"])
        run_id = request.query_params.get("run", "")
        read = named.ledger.last_read
        if read is None or run_id not in read.report.runs.records:
            read = await _in_thread(named.ledger.read)
        if run_id not in read.report.runs.records:
            raise HTTPException(404, f"no run {run_id!r} in {named.ledger.directory}")
        key = _run_key(named.ledger.directory, read, run_id)
        try:
            # shielded: others may wait for the same flight
            page = await asyncio.shield(asyncio.wrap_future(self._flights.page(key)))
        except BrokenProcessPool:
            page = FlownPage("", "The process that flew this run has died; the next click starts another one.")
        if page.refusal:
            self._flights.forget(key)
            return PlainTextResponse(page.refusal, 422)
        return Response(page.json, media_type="application/json")

    async def compare(self, request: Request) -> Response:
        """Two campaigns side by side."""
        keys = [request.query_params.get("first", ""), request.query_params.get("second", "")]
        named = [self._find(key) for key in keys]
        return HTMLResponse(await _in_thread(_compare, self._folder, named))


async def _in_thread(function: Callable[..., T], *arguments: object) -> T:
    """Call a function in a thread that, unlike those of Starlette, does not delay the end of the program."""
    result: Future[T] = Future()

    def work() -> None:
        try:
            result.set_result(function(*arguments))
        except Exception as error:  # noqa: BLE001 - raised below
            result.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return await asyncio.wrap_future(result)


def _row(named: _NamedLedger) -> str:
    try:
        return pages.overview_row(named.ledger.pace(), named.ledger.read().answer)
    except MavfiError as error:
        return pages.refused_row(str(error))


def _campaign(folder: Path, named: _NamedLedger, others: Sequence[str]) -> str:
    return pages.campaign(folder, named.key, named.ledger.pace(), named.ledger.read(), others)


def _state(named: _NamedLedger) -> dict[str, Any]:
    pace = named.ledger.pace()
    return {
        "stamp": pages.stamp_text(named.ledger.stamp()),
        "running": pace.running,
        "complete": pace.status.complete,
        "done": pace.status.done,
        "total": pace.status.total,
        "text": pace.text,
    }


def _compare(folder: Path, named: Sequence[_NamedLedger]) -> str:
    columns = [pages.ComparedCampaign(entry.key, entry.ledger.pace(), entry.ledger.read()) for entry in named]
    return pages.compare(folder, columns)


def _run_key(directory: Path, read: ReadLedger, run_id: str) -> RunKey:
    runs = read.report.runs
    return RunKey(directory, run_id, runs.records[run_id].digest, partner(runs.frame, run_id))


def _refused(request: Request, error: Exception) -> Response:
    """A page with one line for a ledger that is damaged, or an address that names nothing."""
    if isinstance(error, HTTPException):
        return HTMLResponse(pages.refusal(error.detail), error.status_code)
    return HTMLResponse(pages.refusal(str(error)), 409)


def _failed(request: Request, error: Exception) -> Response:
    """A defect: its traceback is for the terminal."""
    traceback.print_exception(error)
    return PlainTextResponse(f"A failure of mavfi, see the terminal: {type(error).__name__}: {error}", 500)


def application(folder: Path, token: str, flights: RequestedFlights) -> Starlette:
    """The application.

    Args:
        folder: Folder with ledgers.
        token: Requests need it.
        flights: Flies runs; the caller closes it.

    Raises:
        BadInputError: The folder holds no ledger, or is itself one that is damaged.
    """
    site = _Site(folder, flights)
    ledgers = site.ledgers()
    if not ledgers:
        raise BadInputError(f"{folder}: holds no campaign, nor does a folder in it; `mavfi campaign run` flies one")
    if list(ledgers) == [""]:
        Store.open(folder).close()
    routes = [
        Route("/", site.overview, methods=["GET"]),
        Route("/row/{key:path}", site.row, methods=["GET"]),
        Route("/campaign/{key:path}", site.campaign, methods=["GET"]),
        Route("/state/{key:path}", site.state, methods=["GET"]),
        Route("/flight/{key:path}", site.flight, methods=["GET"]),
        Route("/compare", site.compare, methods=["GET"]),
    ]
    return Starlette(
        routes=routes,
        middleware=[
            Middleware(TrustedHostMiddleware, allowed_hosts=_NAMES, www_redirect=False),
            Middleware(_TokenMiddleware, token=token),
        ],
        exception_handlers={MavfiError: _refused, HTTPException: _refused, Exception: _failed},
    )
