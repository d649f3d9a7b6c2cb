"""The server: ends at once on Ctrl-C, also while a run is being flown."""

from types import FrameType

import uvicorn

from mavfi.extras.serve.flights import RequestedFlights


class Server(uvicorn.Server):
    """A server whose requests for flights end when it is stopped.

    Args:
        config: Of uvicorn.
        flights: Closed at the end.
    """

    def __init__(self, config: uvicorn.Config, flights: RequestedFlights) -> None:
        super().__init__(config)
        self._flights = flights

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Called by uvicorn on a signal."""
        self._flights.close()
        super().handle_exit(sig, frame)
