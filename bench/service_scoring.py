"""Time from the answer 202 to `scored` beside the bare evaluation of the same bytes in a warm process.

    python bench/service_scoring.py [--images 1525] [--boxes 30] [--rounds 5]

The submission takes the whole way: message, claim, lease, a process of its own that reads, checks and scores it, and
the transaction that records the score. The bare evaluation reads and scores the same zip in one process that has done
it before, with the ground truth prepared. The two take turns; printed are all times and the best of each.
"""

import argparse
import statistics
import sys
import time
import uuid
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import httpx  # noqa: E402 - the path is set above

from bench._installation import Site, machine, running_site  # noqa: E402 - likewise
from bench._workload import Workload, workload  # noqa: E402 - likewise
from evaluator.evaluation import evaluate  # noqa: E402 - likewise
from evaluator.ground_truth import GroundTruth, read_ground_truth  # noqa: E402 - likewise
from evaluator.intake import read_predictions  # noqa: E402 - likewise
from server.database import snapshot_engine  # noqa: E402 - likewise
from server.models import Submission, SubmissionState  # noqa: E402 - likewise

FACTOR_TARGET, EXTRA_TARGET_S = 1.5, 0.150
LOOK_S = 0.004
"""Between two looks at the submission's row; part of what is measured."""


def main() -> int:
    """Measure; status 1 when the target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=1525)
    parser.add_argument("--boxes", type=int, default=30)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    print(f"{args.images} images, {args.boxes} boxes each; {machine()}")
    with workload(args.images, args.boxes) as work, running_site(case=work.folder, workers=1) as site:
        ground_truth = read_ground_truth(work.ground_truth)
        _turn(site, work, ground_truth)  # both are warm now
        turns = [_turn(site, work, ground_truth) for _ in range(args.rounds)]
    return _show(turns)


def _turn(site: Site, work: Workload, ground_truth: GroundTruth) -> tuple[float, float]:
    site.wait_until_idle()
    return _bare(work, ground_truth), time_to_scored_s(site, work.predictions.read_bytes())


def _bare(work: Workload, ground_truth: GroundTruth) -> float:
    started_s = time.perf_counter()
    intake = read_predictions(work.predictions, images=ground_truth.image_list())
    if intake.predictions is None:
        raise SystemExit(f"the workload is refused: {intake.report}")
    evaluate(ground_truth, intake.predictions)
    return time.perf_counter() - started_s


def time_to_scored_s(site: Site, data: bytes) -> float:
    """Send the bytes over HTTP; time from the answer until the row says `scored`."""
    response = httpx.post(
        f"{site.url}/api/v1/submissions",
        params={"benchmark": "cs3d", "phase": "test", "method": "ours"},
        content=data,
        headers={"Authorization": site.authorization, "Content-Type": "application/zip"},
        timeout=60,
    )
    started_s = time.perf_counter()
    submission_id = uuid.UUID(response.raise_for_status().json()["id"])
    while (state := _state(site, submission_id)) is not SubmissionState.SCORED:
        if state.terminal:
            raise SystemExit(f"the submission is {state}")
        time.sleep(LOOK_S)
    return time.perf_counter() - started_s


def _state(site: Site, submission_id: uuid.UUID) -> SubmissionState:
    with snapshot_engine(site.installation.services.engine).connect() as connection:
        query = Submission.__table__.select().where(Submission.id == submission_id)
        return SubmissionState(connection.execute(query).one().state)


def _show(turns: list[tuple[float, float]]) -> int:
    for name, times_s in zip(("bare evaluation", "202 to scored"), zip(*turns, strict=True), strict=True):
        shown = ", ".join(f"{time_s:.3f}" for time_s in times_s)
        print(f"  {name:16} {min(times_s):.3f} s at best, median {statistics.median(times_s):.3f}  ({shown})")
    bare_s, whole_s = (min(times_s) for times_s in zip(*turns, strict=True))
    bound_s = FACTOR_TARGET * bare_s + EXTRA_TARGET_S
    met = whole_s <= bound_s
    print(
        f"  {whole_s / bare_s:.2f} of bare; target {FACTOR_TARGET} x bare + {EXTRA_TARGET_S:.3f} s = {bound_s:.3f} s: "
        f"{'met' if met else 'MISSED'}"
    )
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
