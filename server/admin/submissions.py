"""Commands about submissions."""

import argparse
from collections import defaultdict
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.errors import UsageError
from server import accounts, integrity, ranking
from server import submissions as record
from server.admin.command import DONE, REFUSED, Outcome, Subparsers, actor, add, counted, table
from server.admin.listing import add_limit, listing
from server.benchmarks import find_benchmark, list_benchmarks
from server.errors import NotFound
from server.models import Benchmark, Phase, Submission, SubmissionState
from server.services import Services

FAILED = SubmissionState.FAILED.value
HELD = "held"


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    listed = add(subparsers, "list-submissions", list_submissions)
    listed.add_argument("--benchmark", help="of this benchmark alone")
    listed.add_argument("--phase", help="of phases of this name alone")
    listed.add_argument("--state", choices=[state.value for state in SubmissionState])
    listed.add_argument("--held", action="store_true", help="those that wait for a maintainer's look")
    listed.add_argument("--team", help="of this team alone")
    add_limit(listed)
    requeued = add(subparsers, "requeue", requeue)
    requeued.add_argument("submissions", nargs="*", metavar="SUBMISSION", help="ids of failed submissions")
    requeued.add_argument("--all-failed", action="store_true", help="every failed submission")
    published = add(subparsers, "publish", publish)
    published.add_argument("submission", metavar="SUBMISSION")
    published.add_argument("--withdraw", action="store_true", help="take it off the leaderboard instead")
    held = add(subparsers, "hold", hold)
    held.add_argument("submission", metavar="SUBMISSION")
    held.add_argument("--reason", required=True, help="shown to its team")
    released = add(subparsers, "release", release)
    released.add_argument("submission", metavar="SUBMISSION")
    add(subparsers, "status", status)


def list_submissions(args: argparse.Namespace, services: Services) -> Outcome:
    """List submissions, newest first, with state, mDS and what holds them or made them fail."""
    with services.snapshot() as session:
        found = record.latest(session, *_conditions(session, args), limit=args.limit + 1)
        scores = ranking.shown_scores(session, found)
        mds = {submission_id: score.mds for submission_id, score in scores.items()}
        rows = [_described(submission, mds.get(submission.id)) for submission in found]
    return listing("submissions", rows, limit=args.limit)


def _conditions(session: Session, args: argparse.Namespace) -> list[sa.ColumnElement[bool]]:
    """Say which submissions are asked for.

    Raises:
        NotFound: There is no such benchmark, phase or team.
    """
    conditions: list[sa.ColumnElement[bool]] = []
    if args.benchmark is not None or args.phase is not None:
        conditions.append(Submission.phase_id.in_(_phases(session, args)))
    if args.team is not None:
        conditions.append(Submission.team_id == accounts.find_team(session, args.team).id)
    if args.state is not None:
        conditions.append(Submission.state == SubmissionState(args.state))
    if args.held:
        conditions.append(Submission.held_reason.is_not(None))
    return conditions


def _phases(session: Session, args: argparse.Namespace) -> list[int]:
    query = sa.select(Phase.id).join(Phase.benchmark)
    if args.benchmark is not None:
        query = query.where(Benchmark.id == find_benchmark(session, args.benchmark).id)
    if args.phase is None:
        return list(session.scalars(query))
    found = list(session.scalars(query.where(Phase.slug == args.phase)))
    if not found:
        message = f"there is no phase {args.phase[:80]!r}; `cs3d-admin list-phases` lists them"
        raise NotFound(message)
    return found


def _described(submission: Submission, mds: float | None) -> dict[str, Any]:
    return {
        "id": str(submission.id),
        "created_at": submission.created_at,
        "team": submission.team.slug,
        "method": submission.method.slug,
        "benchmark": submission.phase.benchmark.slug,
        "phase": submission.phase.slug,
        "state": submission.state.value,
        "mds": mds,
        "publication": submission.publication.value,
        "failure": submission.failure_code,
        "held": submission.held_reason,
    }


def requeue(args: argparse.Namespace, services: Services) -> Outcome:
    """Let failed submissions be tried again."""
    if bool(args.submissions) == args.all_failed:
        raise UsageError("give either ids of submissions or --all-failed")
    with services.transaction() as session:
        failed = sa.select(Submission.id).where(Submission.state == SubmissionState.FAILED)
        chosen = args.submissions or list(session.scalars(failed))
        found = [record.find(session, submission_id) for submission_id in chosen]
        for submission in found:
            record.requeue(session, submission, actor=actor())
    sent = [services.queue.enqueue(submission.id) for submission in found]
    text = f"Re-queued {counted(len(found), 'submission')}."
    if not all(sent):
        text += " The broker does not answer; the sweeper will send them once it does."
    data = {"requeued": [str(submission.id) for submission in found], "sent": all(sent)}
    return Outcome(data=data, text=text, status=DONE)


def publish(args: argparse.Namespace, services: Services) -> Outcome:
    """Show a scored submission as its method's row on the leaderboard, or withdraw it."""
    change = record.withdraw if args.withdraw else record.publish
    with services.transaction() as session:
        submission = record.find(session, args.submission)
        change(session, submission, actor=actor())
        publication = str(submission.publication)
    return Outcome(
        data={"submission": args.submission, "publication": publication},
        text=f"Submission {args.submission} is {publication}.",
    )


def hold(args: argparse.Namespace, services: Services) -> Outcome:
    """Take a submission off the leaderboard and keep it off until it is released."""
    with services.transaction() as session:
        record.hold(session, record.find(session, args.submission), reason=args.reason, actor=actor())
    return Outcome(data={"submission": args.submission, "held": args.reason}, text=f"Held {args.submission}.")


def release(args: argparse.Namespace, services: Services) -> Outcome:
    """Let a submission that is held for its integrity audit be published."""
    with services.transaction() as session:
        submission = record.find(session, args.submission)
        reason = submission.held_reason
        integrity.release(session, submission, actor=actor())
    text = f"Released; it was held because: {reason}" if reason else "It is not held."
    return Outcome(data={"submission": args.submission, "was_held": reason}, text=text)


def status(args: argparse.Namespace, services: Services) -> Outcome:
    """Count submissions by phase and state, those that are held, and messages that wait in the broker."""
    del args
    depth = services.queue.depth()
    with services.snapshot() as session:
        phases = _phases_status(session)
    # States that no submission is in would only make the table wide; what waits for a maintainer is always shown.
    found = {FAILED, *(state for one in phases for state, number in one["states"].items() if number)}
    states = [state.value for state in SubmissionState if state.value in found]
    rows = [
        [f"{one['benchmark']}/{one['phase']}", one["version"], *(one["states"][state] for state in states), one[HELD]]
        for one in phases
    ]
    return Outcome(
        data={"broker_depth": depth, "phases": phases},
        text="\n".join(_waiting(phases, depth)),
        tables=[table("phase", "ground truth", *states, HELD, rows=rows)] if rows else [],
        status=REFUSED if depth is None else DONE,
    )


def _waiting(phases: list[dict[str, Any]], depth: int | None) -> list[str]:
    """Say what waits, and for what."""
    held, failed = sum(one[HELD] for one in phases), sum(one["states"][FAILED] for one in phases)
    said = []
    if held:
        said.append(f"{counted(held, 'submission')} held for a maintainer: cs3d-admin list-submissions --held")
    if failed:
        said.append(f"{counted(failed, 'submission')} failed: cs3d-admin list-submissions --state failed")
    waits = "" if depth is None else counted(depth, "message waits", "messages wait")
    return [*said, f"{waits} in the broker." if waits else "The broker does not answer."]


def _phases_status(session: Session) -> list[dict[str, Any]]:
    """Count the submissions of every phase."""
    # The second counts what is not NULL.
    counts = sa.func.count(), sa.func.count(Submission.held_reason)
    query = sa.select(Submission.phase_id, Submission.state, *counts).group_by(Submission.phase_id, Submission.state)
    states: dict[int, dict[str, int]] = defaultdict(lambda: {state.value: 0 for state in SubmissionState})
    held: dict[int, int] = defaultdict(int)
    for phase_id, state, number, held_number in session.execute(query):
        states[phase_id][state.value] = number
        held[phase_id] += held_number
    return [
        {
            "benchmark": benchmark.slug,
            "phase": phase.slug,
            "version": phase.ground_truth.version if phase.ground_truth else None,
            "states": states[phase.id],
            HELD: held[phase.id],
        }
        for benchmark in list_benchmarks(session)
        for phase in benchmark.phases
    ]
