"""Measures what `mavfi mavlink inject` adds to the latency of messages on loopback, at 400 messages a second.

make bench NAME=mavlink_link        # a fault that drops every hundredth message: the numbers of all others move
"""

import socket
import statistics
import subprocess
import sys
import time
from threading import Thread

from pymavlink.dialects.v20 import common

RATE_HZ = 400
SECONDS = 20
FAULT = "ATTITUDE:drop:times=0:every=100@0"
RECEIVE_LIMIT_S = 2.0


def free_port() -> int:
    """A UDP port on loopback that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def latencies_ms(to_port: int, at_port: int) -> list[float]:
    """Time from sending to receiving, of each message that arrives (ms)."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", at_port))
    receiver.settimeout(RECEIVE_LIMIT_S)
    count = RATE_HZ * SECONDS
    sent_at = [0.0] * count
    latencies: list[float] = []
    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    parser = common.MAVLink(None)

    def receive() -> None:
        try:
            while True:
                data = receiver.recv(2048)
                now = time.perf_counter()
                for message in parser.parse_buffer(data) or []:
                    latencies.append(1e3 * (now - sent_at[message.time_boot_ms]))
        except TimeoutError:
            return

    thread = Thread(target=receive)
    thread.start()
    start = time.perf_counter()
    for number in range(count):
        data = common.MAVLink_attitude_message(number, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6).pack(link)
        link.seq = (link.seq + 1) % 256
        time.sleep(max(0.0, start + number / RATE_HZ - time.perf_counter()))
        sent_at[number] = time.perf_counter()
        sender.sendto(data, ("127.0.0.1", to_port))
    thread.join()
    sender.close()
    receiver.close()
    return latencies


def line(name: str, latencies: list[float]) -> str:
    """Median, 99th percentile and maximum."""
    ordered = sorted(latencies)
    return (
        f"{name:<22} {len(ordered)} messages, latency ms: median {statistics.median(ordered):.3f}, "
        f"99 % {ordered[int(0.99 * len(ordered))]:.3f}, longest {ordered[-1]:.3f}"
    )


def main() -> None:
    """Print the latencies without and with the link."""
    port = free_port()
    print(line("without the link", latencies_ms(port, port)))
    ports = free_port(), free_port()
    ends = ["--from", f"udpin:127.0.0.1:{ports[0]}", "--to", f"udpout:127.0.0.1:{ports[1]}"]
    command = [sys.executable, "-m", "mavfi", "mavlink", "inject", *ends, "--fault", FAULT, "--json"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as link:
        time.sleep(3.0)  # until it listens
        print(line("through the link", latencies_ms(*ports)))
        link.terminate()


if __name__ == "__main__":
    main()
