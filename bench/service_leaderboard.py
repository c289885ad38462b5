"""p99 of the leaderboard while uploads and scoring run, against an idle server.

    python bench/service_leaderboard.py [--seconds 8] [--rounds 3] [--uploads 8] [--methods 40]

Readers ask for the ranking at a steady, modest rate. Idle and busy stretches take turns; while busy, eight clients
upload archives one after the other, each at the rate of a good line, and a worker scores them. Printed is the median
over the rounds of the p99 of each, and of their ratio.
"""

import argparse
import statistics
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import httpx  # noqa: E402 - the path is set above

from bench._installation import Site, machine, running_site  # noqa: E402 - likewise
from bench._load import Load, drive, get_request  # noqa: E402 - likewise
from bench._workload import workload  # noqa: E402 - likewise
from server import submissions  # noqa: E402 - likewise
from server.models import SubmissionState  # noqa: E402 - likewise

TARGET = 2.0
READERS, PAUSE_S = 4, 0.05
BLOCK_BYTES, LINE_BYTES_PER_S = 64 << 10, 12_500_000
"""Of each upload: 100 Mbit/s."""


def main() -> int:
    """Measure; status 1 when the target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--uploads", type=int, default=8)
    parser.add_argument("--methods", type=int, default=40)
    args = parser.parse_args()
    print(f"{args.methods} methods, {args.uploads} uploads at a time; {machine()}")
    with workload(200, 30) as work, running_site(case=work.folder, workers=1) as site:
        data = work.predictions.read_bytes()
        _fill(site, data, args.methods)
        _read(site, 1.0)
        idle, busy = [], []
        for _ in range(args.rounds):
            site.wait_until_idle()
            idle.append(_read(site, args.seconds))
            with _uploading(site, data, args.uploads):
                busy.append(_read(site, args.seconds))
    return _show(idle, busy)


def _fill(site: Site, data: bytes, methods: int) -> None:
    """Publish one submission for each method."""
    installation = site.installation
    for number in range(methods):
        submission_id = installation.submit(data, method=f"method-{number}")
        installation.wait_for(submission_id, SubmissionState.SCORED)
        with installation.services.transaction() as session:
            submissions.publish(session, submissions.find(session, submission_id), f"user:{installation.user.id}")


def _read(site: Site, seconds: float) -> Load:
    return drive(
        site.web.port,
        get_request("/api/v1/leaderboards/cs3d/test"),
        server_pid=site.web.pid,
        seconds=seconds,
        connections=READERS,
        pause_s=PAUSE_S,
    )


@contextmanager
def _uploading(site: Site, data: bytes, uploads: int) -> Iterator[None]:
    """Upload and score for as long as the block lasts."""
    ended = threading.Event()
    clients = [threading.Thread(target=_upload, args=(site, data, ended), daemon=True) for _ in range(uploads)]
    for client in clients:
        client.start()
    try:
        yield
    finally:
        ended.set()
        for client in clients:
            client.join()


def _upload(site: Site, data: bytes, ended: threading.Event) -> None:
    headers = {"Authorization": site.authorization, "Content-Type": "application/zip", "Content-Length": str(len(data))}
    order = {"benchmark": "cs3d", "phase": "test", "method": "busy"}
    with httpx.Client(base_url=site.url, headers=headers, params=order, timeout=60) as client:
        while not ended.is_set():
            client.post("/api/v1/submissions", content=_as_over_a_line(data)).raise_for_status()


def _as_over_a_line(data: bytes) -> Iterator[bytes]:
    for at in range(0, len(data), BLOCK_BYTES):
        yield data[at : at + BLOCK_BYTES]
        time.sleep(BLOCK_BYTES / LINE_BYTES_PER_S)


def _show(idle: list[Load], busy: list[Load]) -> int:
    for name, loads in (("idle", idle), ("busy", busy)):
        p50_ms, p99_ms = (1000 * statistics.median(load.quantile_s(q) for load in loads) for q in (0.5, 0.99))
        per_s = statistics.median(load.per_s for load in loads)
        print(f"  {name}: p50 {p50_ms:6.1f} ms, p99 {p99_ms:6.1f} ms at {per_s:.0f} requests a second")
    ratio = statistics.median(b.quantile_s(0.99) / i.quantile_s(0.99) for i, b in zip(idle, busy, strict=True))
    print(f"  {ratio:.2f} times the idle p99, target {TARGET}: {'met' if ratio <= TARGET else 'MISSED'}")
    return 0 if ratio <= TARGET else 1


if __name__ == "__main__":
    sys.exit(main())
