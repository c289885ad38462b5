"""Requests a second of status polling beside a bare Starlette route under the same uvicorn settings.

    python bench/service_polling.py [--seconds 3] [--rounds 5] [--connections 32]

Three requests for a submission's status, each with a bearer token: one that waits, one that is scored, and one that is
scored asked for with If-None-Match. The runs are interleaved; a round gives one ratio to its own bare run, printed is
the median over the rounds. The ratio of the server's processor time per answer is printed beside it: other programs
on the machine hardly move that one.
"""

import argparse
import statistics
import sys
import uuid
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import httpx  # noqa: E402 - the path is set above

from bench._installation import Site, WebServer, machine, running_beside, running_site  # noqa: E402 - likewise
from bench._load import Load, drive, get_request  # noqa: E402 - likewise
from server.models import SubmissionState  # noqa: E402 - likewise

WAITING_TARGET, UNCHANGED_TARGET = 0.25, 0.6


@dataclass(frozen=True, slots=True)
class Case:
    """One request that is measured."""

    title: str
    web: WebServer
    request: bytes
    status: int = 200
    target: float | None = None


def main() -> int:
    """Measure; status 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--connections", type=int, default=32)
    args = parser.parse_args()
    print(machine())
    with running_site() as site, running_beside(site, "bench._bare_route:application") as bare:
        cases = [Case("bare route", bare, get_request("/")), *_cases(site)]
        rounds = [[_load(case, args.seconds, args.connections) for case in cases] for _ in range(args.rounds)]
    met = [_show(case, index, rounds) for index, case in enumerate(cases)]
    return 0 if all(met) else 1


def _cases(site: Site) -> list[Case]:
    """Bring submissions into the states and compose the requests."""
    scored = site.installation.submit()
    worker = site.installation.start_worker()
    site.installation.wait_for(scored, SubmissionState.SCORED)
    worker.stop()
    waiting = site.installation.submit(method="later", enqueue=False)
    etag = httpx.get(f"{site.url}{_path(scored)}", headers={"Authorization": site.authorization}).headers["etag"]

    def request(submission_id: uuid.UUID, **headers: str) -> bytes:
        return get_request(_path(submission_id), Authorization=site.authorization, **headers)

    return [
        Case("waiting", site.web, request(waiting), target=WAITING_TARGET),
        Case("scored", site.web, request(scored), target=WAITING_TARGET),
        Case("scored, If-None-Match", site.web, request(scored, If_None_Match=etag), 304, UNCHANGED_TARGET),
    ]


def _path(submission_id: uuid.UUID) -> str:
    return f"/api/v1/submissions/{submission_id}"


def _load(case: Case, seconds: float, connections: int) -> Load:
    return drive(
        case.web.port,
        case.request,
        server_pid=case.web.pid,
        seconds=seconds,
        connections=connections,
        status=case.status,
    )


def _show(case: Case, index: int, rounds: list[list[Load]]) -> bool:
    """Print one line; return whether the target is met."""
    ratio = statistics.median(loads[index].per_s / loads[0].per_s for loads in rounds)
    cpu_ratio = statistics.median(loads[0].cpu_s_each / loads[index].cpu_s_each for loads in rounds)
    per_s = statistics.median(loads[index].per_s for loads in rounds)
    p99_ms = 1000 * statistics.median(loads[index].quantile_s(0.99) for loads in rounds)
    met = case.target is None or ratio >= case.target
    target = "" if case.target is None else f"  target {case.target}: {'met' if met else 'MISSED'}"
    print(
        f"  {case.title:24} {per_s:8.0f}/s  p99 {p99_ms:6.1f} ms  {ratio:5.2f} of bare"
        f"  by processor time {cpu_ratio:5.2f}{target}"
    )
    return met


if __name__ == "__main__":
    sys.exit(main())
