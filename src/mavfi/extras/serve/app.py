"""The application: pages of campaigns and flights on loopback, for the holder of a token, read-only."""

import asyncio
import secrets
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
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
from mavfi.extras.serve.ledgers import ServedLedger, find_ledgers

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
            key: self._ledgers.get(key) or ServedLedger(directory, key) for key, directory in directories.items()
        }
        return self._ledgers

    def _find(self, key: str) -> ServedLedger:
        ledger = self._ledgers.get(key) or self.ledgers().get(key)
        if ledger is None:
            raise HTTPException(404, f"no campaign {key!r} in {self._folder}")
        return ledger

    async def overview(self, request: Request) -> Response:
        """All campaigns, with the headline of each; that of the only one is its own page."""
        ledgers = await _in_thread(self.ledgers)
        if list(ledgers) == [""]:
            return RedirectResponse("/campaign/")
        return HTMLResponse(pages.overview(self._folder, list(ledgers)))

    async def row(self, request: Request) -> Response:
        """The row of a campaign in the overview."""
        ledger = self._find(request.path_params["key"])
        return HTMLResponse(await _in_thread(_row, ledger))

    async def campaign(self, request: Request) -> Response:
        """The page of a campaign; before its ledger is read, one that says so and asks again."""
        ledger = self._find(request.path_params["key"])
        if ledger.last_read is None and _WAITS not in request.headers:
            return HTMLResponse(pages.reading(self._folder, ledger.key))
        others = [key for key in await _in_thread(self.ledgers) if key != ledger.key]
        return HTMLResponse(await _in_thread(self._campaign_page, ledger, others))

    def _campaign_page(self, ledger: ServedLedger, others: Sequence[str]) -> str:
        return pages.campaign(self._folder, ledger.key, ledger.pace(), ledger.read(), others)

    async def state(self, request: Request) -> Response:
        """Stamp and progress of a campaign, which its page asks for while it is open."""
        ledger = self._find(request.path_params["key"])
        return JSONResponse(await _in_thread(_state, ledger))

    async def flight(self, request: Request) -> Response:
        """The page of a run as JSON, after flying it; 422 = it cannot be flown, and why."""
        ledger = self._find(request.path_params["key"])
        run_id = request.query_params.get("run", "")
        read = ledger.last_read
        if read is None or run_id not in read.report.runs.records:
            read = await _in_thread(ledger.read)
        runs = read.report.runs
        if run_id not in runs.records:
            raise HTTPException(404, f"no run {run_id!r} in {ledger.directory}")
        key = RunKey(ledger.directory, run_id, runs.records[run_id].digest, partner(runs.frame, run_id))
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
        ledgers = [self._find(request.query_params.get(name, "")) for name in ("first", "second")]
        return HTMLResponse(await _in_thread(self._comparison_page, ledgers))

    def _comparison_page(self, ledgers: Sequence[ServedLedger]) -> str:
        campaigns = [pages.ComparedCampaign(ledger.key, ledger.pace(), ledger.read()) for ledger in ledgers]
        return pages.compare(self._folder, campaigns)


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


def _row(ledger: ServedLedger) -> str:
    try:
        return pages.overview_row(ledger.pace(), ledger.read().answer)
    except MavfiError as error:
        return pages.refused_row(str(error))


def _state(ledger: ServedLedger) -> dict[str, Any]:
    pace = ledger.pace()
    return {
        "stamp": pages.stamp_text(ledger.stamp()),
        "running": pace.running,
        "complete": pace.status.complete,
        "done": pace.status.done,
        "total": pace.status.total,
        "text": pace.text,
    }


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
