"""The XML-RPC interfaces of the ROS master and of nodes: http://wiki.ros.org/ROS/Master_API and .../Slave_API."""

import http.client
import os
import socket
import xmlrpc.client
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from urllib.parse import urlparse

from mavfi.errors import BadInputError, MavfiError, allowed, hint

URI_VARIABLE = "ROS_MASTER_URI"
_DEFAULT_URI = "http://127.0.0.1:11311"
CALLER = "/mavfi"
MASTER_CALLER = "/master"
"""Caller name of the master when it notifies nodes of publishers."""
PATIENCE_S = 3.0
_DONE = 1


class SilentError(MavfiError):
    """A participant of the graph does not respond."""


class _Transport(xmlrpc.client.Transport):
    """HTTP with a timeout."""

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = PATIENCE_S
        return connection


def absolute(name: str) -> str:
    """The name with its leading slash."""
    if name.startswith("/"):
        return name
    return f"/{name}"


def check_known(what: str, name: str, names: Collection[str]) -> str:
    """Return the absolute name; `BadInputError`, listing the known names, if it is unknown."""
    wanted = absolute(name)
    if wanted not in names:
        raise BadInputError(
            f"{what} {wanted}: not in the graph{hint(wanted, names)}; allowed: {allowed(names, wanted)}"
        )
    return wanted


def call(uri: str, method: str, *arguments: Any) -> Any:
    """Call a method of a master or node; the first argument is the caller's node name.

    Raises:
        SilentError: No response within PATIENCE_S.
        MavfiError: The call was refused.
    """
    try:
        with xmlrpc.client.ServerProxy(uri, transport=_Transport()) as proxy:
            code, text, value = getattr(proxy, method)(*arguments)
    except (OSError, http.client.HTTPException, xmlrpc.client.ProtocolError) as error:
        raise SilentError(f"{uri}: does not answer ({error})") from None
    except (xmlrpc.client.Error, TypeError, ValueError) as error:
        raise MavfiError(f"{uri}: {method}: {error}") from None
    if code != _DONE:
        raise MavfiError(f"{uri}: {method}: {text}")
    return value


@dataclass(frozen=True)
class RosGraph:
    """Publishers, subscribers and types by topic, providers by service; type "*" = unknown, subscribers only."""

    publishers: dict[str, list[str]]
    subscribers: dict[str, list[str]]
    services: dict[str, list[str]]
    types: dict[str, str]

    @cached_property
    def nodes(self) -> list[str]:
        """Names of all registered nodes."""
        tables = (self.publishers, self.subscribers, self.services)
        return sorted({node for table in tables for nodes in table.values() for node in nodes})

    @cached_property
    def topics(self) -> list[str]:
        """Names of all topics."""
        return sorted({*self.publishers, *self.subscribers})


class Master:
    """A running ROS master; default address: variable ROS_MASTER_URI, else port 11311 of this machine.

    Raises:
        BadInputError: No master responds at the address.
    """

    def __init__(self, uri: str | None = None) -> None:
        self.uri = uri or os.environ.get(URI_VARIABLE) or _DEFAULT_URI
        try:
            self.call("getPid")
        except MavfiError:
            raise BadInputError(
                f"no ROS master at {self.uri}: start one with `roscore`, or say in {URI_VARIABLE} where it is"
            ) from None

    def call(self, method: str, *arguments: Any, caller: str = CALLER) -> Any:
        """Call the master; see `call`."""
        return call(self.uri, method, caller, *arguments)

    def graph(self) -> RosGraph:
        """The current graph."""
        publishers, subscribers, services = (dict(table) for table in self.call("getSystemState"))
        return RosGraph(publishers, subscribers, services, dict(self.call("getTopicTypes")))

    def node_uri(self, name: str) -> str:
        """Address of a node; `BadInputError` if it is not registered."""
        try:
            uri: str = self.call("lookupNode", absolute(name))
        except SilentError:
            raise
        except MavfiError:
            check_known("node", name, self.graph().nodes)
            raise
        return uri

    def node_pid(self, name: str) -> int:
        """Process id of a node on this machine; `BadInputError` if it is unregistered, dead, or runs elsewhere."""
        node = absolute(name)
        uri = self.node_uri(node)
        try:
            pid = int(call(uri, "getPid", CALLER))
        except SilentError:
            raise BadInputError(
                f"node {node}: is registered, but does not answer at {uri}: it has died; `rosnode cleanup` takes such "
                "nodes out of the graph, then start it again"
            ) from None
        if not is_here(uri):
            raise BadInputError(f"node {node}: runs on {urlparse(uri).hostname}: start mavfi on that machine")
        return pid


def is_here(uri: str) -> bool:
    """Whether a node's address belongs to this machine."""
    host = urlparse(uri).hostname or ""
    if host in ("localhost", socket.gethostname(), os.environ.get("ROS_IP"), os.environ.get("ROS_HOSTNAME")):
        return True
    try:
        address = socket.gethostbyname(host)
        return address in {"127.0.0.1", "127.0.1.1", *socket.gethostbyname_ex(socket.gethostname())[2]}
    except OSError:
        return False
