"""A minimal client of the Foxglove WebSocket protocol, with the library websocket-client."""

import json
import struct
from typing import Any


class Viewer:
    """A minimal client of the Foxglove WebSocket protocol."""

    def __init__(self, address: str) -> None:
        import websocket

        self._socket = websocket.create_connection(address, subprotocols=["foxglove.sdk.v1"], timeout=10)
        self.channels: dict[str, Any] = {}
        self._topics: dict[int, str] = {}
        self.messages: list[tuple[str, int, bytes]] = []

    def subscribe(self, count: int) -> None:
        """Subscribe to every topic, once `count` are advertised."""
        while len(self.channels) < count:
            data = json.loads(self._socket.recv())
            self.channels |= {c["topic"]: c for c in data.get("channels", ())}
        self._topics = {number: topic for number, topic in enumerate(self.channels)}
        wanted = [{"id": number, "channelId": self.channels[topic]["id"]} for number, topic in self._topics.items()]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def collect(self) -> None:
        """Messages until the server stops: topic, stamp (ns), content."""
        try:
            while True:
                data = self._socket.recv()
                if isinstance(data, bytes) and data[:1] == b"\x01":
                    number, stamp = struct.unpack_from("<IQ", data, 1)
                    self.messages.append((self._topics[number], stamp, data[13:]))
        except Exception:  # noqa: BLE001 - closed by the server
            self._socket.shutdown()
