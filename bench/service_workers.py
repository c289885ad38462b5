"""Four scoring processes against one on a queue of 200 small submissions.

    python bench/service_workers.py [--submissions 200] [--images 20] [--boxes 30] [--workers 4]

Each run queues the submissions while nobody works, starts a worker with so many processes, and takes the time from the
first score to the last, so that starting up does not count. More processes than processors cannot help: the target is
what the processors allow, with the database's one writer and the broker taking their share.
"""

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import psutil  # noqa: E402 - the path is set above
import sqlalchemy as sa  # noqa: E402 - likewise

from bench._installation import Site, machine, running_site  # noqa: E402 - likewise
from bench._workload import workload  # noqa: E402 - likewise
from server.models import Submission, SubmissionState  # noqa: E402 - likewise

SHARE_TARGET = 0.7
"""Of the speed-up that as many processors as are there, or as processes, could give."""
LONGEST_S = 300.0


def main() -> int:
    """Measure; status 1 when the target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--submissions", type=int, default=200)
    parser.add_argument("--images", type=int, default=20)
    parser.add_argument("--boxes", type=int, default=30)
    parser.add_argument("--workers", type=int, default=4)
    args = parser.parse_args()
    print(f"{args.submissions} submissions of {args.images} images, {args.boxes} boxes each; {machine()}")
    with workload(args.images, args.boxes) as work:
        data = work.predictions.read_bytes()
        per_s = []
        for processes in (1, args.workers):
            with running_site(case=work.folder) as site:
                per_s.append(_rate(site, data, args.submissions, processes))
            print(f"  {processes} at a time: {per_s[-1]:6.1f} submissions a second")
    possible = min(args.workers, psutil.cpu_count() or 1)
    ratio, target = per_s[1] / per_s[0], SHARE_TARGET * possible
    print(f"  {ratio:.2f} times as fast; target {target:.1f}: {'met' if ratio >= target else 'MISSED'}")
    return 0 if ratio >= target else 1


def _rate(site: Site, data: bytes, count: int, processes: int) -> float:
    for _ in range(count):
        site.installation.submit(data)
    site.installation.start_worker(concurrency=processes)
    deadline_s = time.monotonic() + LONGEST_S
    while _unfinished(site):
        if time.monotonic() > deadline_s:
            raise SystemExit(f"not all of {count} submissions were scored within {LONGEST_S:g} s")
        time.sleep(0.1)
    return _scores_a_second(site)


def _unfinished(site: Site) -> int:
    query = sa.select(sa.func.count()).where(Submission.state != SubmissionState.SCORED)
    with site.installation.services.snapshot() as session:
        return session.scalar(query) or 0


def _scores_a_second(site: Site) -> float:
    """Take the times from the record itself."""
    query = sa.select(Submission.state_changed_at).order_by(Submission.state_changed_at)
    with site.installation.services.snapshot() as session:
        times = list(session.scalars(query))
    return (len(times) - 1) / (times[-1] - times[0]).total_seconds()


if __name__ == "__main__":
    sys.exit(main())
