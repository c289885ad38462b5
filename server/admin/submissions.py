"""Commands about submissions."""

import argparse
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.errors import UsageError
from server import integrity
from server import submissions as record
from server.admin.command import DONE, REFUSED, Outcome, Subparsers, actor, add, table
from server.benchmarks import list_benchmarks
from server.models import Phase, Submission, SubmissionState
from server.services import Services


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
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
    text = f"Re-queued {len(found)} submissions."
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
    """Count submissions by phase and state, and messages that wait in the broker."""
    del args
    depth = services.queue.depth()
    with services.snapshot() as session:
        phases = [_phase_status(session, phase) for benchmark in list_benchmarks(session) for phase in benchmark.phases]
    # States that no submission is in would only make the table wide.
    states = [state.value for state in SubmissionState if any(one["states"][state.value] for one in phases)]
    rows = [
        [f"{one['benchmark']}/{one['phase']}", one["version"], *(one["states"][state] for state in states)]
        for one in phases
    ]
    text = "The broker does not answer." if depth is None else f"{depth} messages wait in the broker."
    return Outcome(
        data={"broker_depth": depth, "phases": phases},
        text=text,
        tables=[table("phase", "ground truth", *states, rows=rows)] if rows else [],
        status=REFUSED if depth is None else DONE,
    )


def _phase_status(session: Session, phase: Phase) -> dict[str, Any]:
    """Count one phase's submissions."""
    counted = session.execute(
        sa.select(Submission.state, sa.func.count()).where(Submission.phase_id == phase.id).group_by(Submission.state)
    )
    counts = {state.value: number for state, number in counted}
    version = phase.ground_truth.version if phase.ground_truth else None
    return {
        "benchmark": phase.benchmark.slug,
        "phase": phase.slug,
        "version": version,
        "states": {state.value: counts.get(state.value, 0) for state in SubmissionState},
    }
