"""Time from the answer 202 to `scored` of one large submission: in one piece, and in shards by two processes.

    python bench/service_shards.py [--images 1525] [--boxes 100] [--shards 2] [--rounds 3]

Both ways go through the same installation with two scoring processes, in turns. In one piece one of them is idle. In
shards the holder validates the whole upload first, both match, and the holder joins: what is divided is the matching
for scores and integrity audit. Printed are all times and the ratio of the best.
"""

import argparse
import statistics
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bench._installation import Site, machine, running_site  # noqa: E402 - the path is set above
from bench._workload import workload  # noqa: E402 - likewise
from bench.service_scoring import time_to_scored_s  # noqa: E402 - likewise
from server import benchmarks  # noqa: E402 - likewise


def main() -> int:
    """Measure; status 1 when shards are slower than one piece."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=1525)
    parser.add_argument("--boxes", type=int, default=100)
    parser.add_argument("--shards", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    print(f"{args.images} images, {args.boxes} boxes each; {machine()}")
    with workload(args.images, args.boxes) as work, running_site(case=work.folder, workers=2) as site:
        data = work.predictions.read_bytes()
        _scored_in(site, data, 1), _scored_in(site, data, args.shards)  # both processes are warm now
        turns = [(_scored_in(site, data, 1), _scored_in(site, data, args.shards)) for _ in range(args.rounds)]
    return _show(turns, args.shards)


def _scored_in(site: Site, data: bytes, shards: int) -> float:
    site.wait_until_idle()
    with site.installation.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        benchmarks.set_shards(session, phase, shards, actor="admin:bench")
    return time_to_scored_s(site, data)


def _show(turns: list[tuple[float, float]], shards: int) -> int:
    for name, times_s in zip(("in one piece", f"in {shards} shards"), zip(*turns, strict=True), strict=True):
        shown = ", ".join(f"{time_s:.3f}" for time_s in times_s)
        print(f"  {name:14} {min(times_s):.3f} s at best, median {statistics.median(times_s):.3f}  ({shown})")
    whole_s, sharded_s = (min(times_s) for times_s in zip(*turns, strict=True))
    print(f"  {sharded_s / whole_s:.2f} of the time in one piece")
    return 0 if sharded_s < whole_s else 1


if __name__ == "__main__":
    sys.exit(main())
