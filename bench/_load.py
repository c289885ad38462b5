"""A load client in plain asyncio: some connections, each sending its next request when the last one is answered.

It does as little as possible per answer, so that on two processors it keeps up with a bare route; both sides of a
ratio are measured with it alike.
"""

import asyncio
import time
from dataclasses import dataclass, field
from typing import cast

import psutil
import uvloop

GRACE_S = 10.0
"""For answers that are still on their way at the end of a run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What one run came to."""

    seconds: float
    latencies_s: list[float]
    """Of every answered request, in the order of the answers."""
    server_cpu_s: float
    """Processor time that the server process took meanwhile."""

    @property
    def per_s(self) -> float:
        """Answers a second."""
        return len(self.latencies_s) / self.seconds

    @property
    def cpu_s_each(self) -> float:
        """Processor seconds of the server per answer; other programs on the machine hardly move it."""
        return self.server_cpu_s / len(self.latencies_s)

    def quantile_s(self, share: float) -> float:
        """Latency that `share` of the answers do not exceed (nearest rank)."""
        ordered = sorted(self.latencies_s)
        return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


@dataclass(slots=True, kw_only=True)
class _Run:
    """What the connections of one run share."""

    request: bytes
    status: int
    pause_s: float
    until_s: float
    latencies_s: list[float] = field(default_factory=list)
    failure: str = ""


class _Connection(asyncio.Protocol):
    """One connection that is kept alive."""

    def __init__(self, run: _Run) -> None:
        self._run = run
        self._received = b""
        self._sent_s = 0.0
        self._transport: asyncio.WriteTransport | None = None
        self.done = asyncio.get_running_loop().create_future()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.WriteTransport", transport)
        self._send()

    def _send(self) -> None:
        if self._transport is None or time.perf_counter() >= self._run.until_s:
            self._finish()
            return
        self._sent_s = time.perf_counter()
        self._transport.write(self._run.request)

    def data_received(self, data: bytes) -> None:
        self._received += data
        head, found, body = self._received.partition(b"\r\n\r\n")
        if not found or len(body) < _content_length(head):
            return
        self._received = b""
        self._run.latencies_s.append(time.perf_counter() - self._sent_s)
        status = int(head[9:12])
        if status != self._run.status:
            self._run.failure = f"answered {status} instead of {self._run.status}: {body[:300]!r}"
            self._finish()
        elif self._run.pause_s:
            asyncio.get_running_loop().call_later(self._run.pause_s, self._send)
        else:
            self._send()

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.done.done():
            self._run.failure = f"the connection was closed: {exc!r}"
            self._finish()

    def _finish(self) -> None:
        if not self.done.done():
            self.done.set_result(None)
        if self._transport is not None:
            self._transport.close()


def _content_length(head: bytes) -> int:
    _, found, rest = head.lower().partition(b"\r\ncontent-length:")
    return int(rest.partition(b"\r\n")[0]) if found and head[9:12] != b"304" else 0


def get_request(path: str, **headers: str) -> bytes:
    """Compose a GET request; underscores in the names of headers stand for dashes."""
    lines = [f"GET {path} HTTP/1.1", "Host: 127.0.0.1", *(f"{k.replace('_', '-')}: {v}" for k, v in headers.items())]
    return "\r\n".join([*lines, "", ""]).encode()


def drive(
    port: int,
    request: bytes,
    *,
    server_pid: int,
    seconds: float,
    connections: int,
    status: int = 200,
    pause_s: float = 0.0,
) -> Load:
    """Send one request over and over.

    Args:
        port: where the server listens on loopback.
        request: its bytes.
        server_pid: the process whose processor time is taken.
        seconds: how long.
        connections: how many requests are under way at a time.
        status: what every answer must have.
        pause_s: each connection waits so long after an answer; 0 loads the server fully.

    Raises:
        SystemExit: An answer was another one.
    """
    run = _Run(request=request, status=status, pause_s=pause_s, until_s=0.0)
    process = psutil.Process(server_pid)
    before = process.cpu_times()
    started_s = time.perf_counter()
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(_drive(port, run, connections, seconds))
    elapsed_s, after = time.perf_counter() - started_s, process.cpu_times()
    if run.failure or not run.latencies_s:
        raise SystemExit(run.failure or "nothing was answered")
    cpu_s = after.user + after.system - before.user - before.system
    return Load(seconds=elapsed_s, latencies_s=run.latencies_s, server_cpu_s=cpu_s)


async def _drive(port: int, run: _Run, connections: int, seconds: float) -> None:
    loop = asyncio.get_running_loop()
    run.until_s = time.perf_counter() + seconds
    made = [await loop.create_connection(lambda: _Connection(run), "127.0.0.1", port) for _ in range(connections)]
    async with asyncio.timeout(seconds + GRACE_S):
        await asyncio.gather(*(connection.done for _, connection in made))
