"""The command `rescore`: score a phase's submissions again, look at what changes, put it in force."""

import argparse
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
from sqlalchemy.orm import Session

from evaluator.errors import UsageError
from evaluator.protocol import PROTOCOLS
from server import benchmarks, rescoring_decisions, submissions
from server import rescoring as record
from server.admin.command import DONE, REFUSED, Outcome, Subparsers, actor, add, add_phase, counted, table, whole_number
from server.models import Phase
from server.rank_changes import RankChanges, rank_changes
from server.ranking import Basis
from server.services import Services

BAR_WIDTH = 30


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    summary = "Score a phase's submissions again beside what ranks, compare, and put it in force."
    parser = subparsers.add_parser("rescore", help=summary, description=summary)
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    starting = _add(actions, "start", start)
    which = starting.add_mutually_exclusive_group()
    which.add_argument("--ground-truth", type=Path, metavar="SOURCE", help="folder or zip to import as a version")
    which.add_argument(
        "--version", type=whole_number(1), metavar="N", help="of the ground truth (default: the one in force)"
    )
    starting.add_argument("--protocol", choices=sorted(PROTOCOLS), help="default: the one in force")
    _add(actions, "status", status)
    _add(actions, "diff", diff)
    retrying = _add(actions, "retry", retry)
    retrying.add_argument("submission", nargs="?", help="this one alone, also when it is excluded")
    excluding = _add(actions, "exclude", exclude)
    excluding.add_argument("submission")
    excluding.add_argument("--reason", required=True, help="shown to its team")
    _add(actions, "publish", publish)
    _add(actions, "discard", discard)


def _add(actions: Subparsers, name: str, run: Any) -> argparse.ArgumentParser:  # noqa: ANN401 - as in command.add
    """Add an action on a phase."""
    parser = add(actions, name, run)
    add_phase(parser)
    return parser


def _phase(session: Session, args: argparse.Namespace) -> Phase:
    return benchmarks.find_phase(session, args.benchmark, args.phase)


def start(args: argparse.Namespace, services: Services) -> Outcome:
    """Begin to score every scored submission again, behind whatever teams wait for."""
    if args.ground_truth is not None and not args.ground_truth.exists():
        message = f"{args.ground_truth} does not exist; give a folder or a zip"
        raise UsageError(message)
    prepared = benchmarks.prepare_ground_truth(services.blobs, args.ground_truth) if args.ground_truth else None
    with services.transaction() as session:
        phase, number = _phase(session, args), args.version
        if prepared is not None:
            number = benchmarks.add_ground_truth(
                session, services.blobs, phase=phase, prepared=prepared, actor=actor()
            ).version
        rescoring = record.start(session, phase=phase, version=number, protocol=args.protocol, actor=actor())
        items = record.waiting(session, rescoring)
        basis = record.describe(session, Basis.of(rescoring))
    data = {"rescoring": rescoring.id, "basis": basis, "items": len(items), "sent": _send(services, items)}
    place = f"{args.benchmark} {args.phase}"
    begun = counted(len(items), "submission is", "submissions are")
    return Outcome(data=data, text=f"{begun} scored again. Next: cs3d-admin rescore status {place}")


def _send(services: Services, items: Iterable[int]) -> bool:
    """Tell the workers; False when the broker does not answer, and the sweeper will."""
    sent = [services.queue.enqueue_item(item_id) for item_id in items]
    return all(sent)


def status(args: argparse.Namespace, services: Services) -> Outcome:
    """Show how far a re-scoring is, and what failed; status 1 when something failed."""
    with services.snapshot() as session:
        rescoring = record.get_running(session, _phase(session, args))
        progress = record.progress(session, rescoring)
        basis = record.describe(session, Basis.of(rescoring))
        failed = [[str(one.submission_id), one.failure_code, one.failure_detail] for one in progress.failures]
    counts = {state.value: number for state, number in progress.counts.items()} | {"new": progress.uncovered}
    columns = ("submission", "failure", "detail")
    data = {
        "basis": basis,
        "counts": counts,
        "complete": progress.complete,
        "failed": [dict(zip(columns, row, strict=True)) for row in failed],
    }
    listed = ", ".join(f"{number} {state}" for state, number in counts.items() if number)
    text = f"{_bar(progress.settled, progress.total)} {listed or 'nothing to score'}"
    tables = [table(*columns, rows=failed)] if failed else []
    return Outcome(data=data, text=text, tables=tables, status=REFUSED if failed else DONE)


def _bar(done: int, total: int) -> str:
    """Draw how much is done; everything when there is nothing to do."""
    filled = BAR_WIDTH * done // total if total else BAR_WIDTH
    return f"[{'#' * filled}{'-' * (BAR_WIDTH - filled)}] {done}/{total}"


def diff(args: argparse.Namespace, services: Services) -> Outcome:
    """Compare the ranking in force with the one to come: ranks, mDS, who enters or leaves, integrity findings."""
    with services.snapshot() as session:
        phase = _phase(session, args)
        changes = rank_changes(session, phase, record.get_running(session, phase))
    return Outcome(
        data=_diff_document(changes),
        text="" if changes.complete else "Not complete: submissions wait for their new score.",
        tables=_diff_tables(changes),
    )


def _diff_document(changes: RankChanges) -> dict[str, Any]:
    document: dict[str, Any] = msgspec.to_builtins(changes)
    for row, written in zip(changes.rows, document["rows"], strict=True):
        written["change"] = row.change
    return document


def _diff_tables(changes: RankChanges) -> list[Any]:
    rows = [
        [row.change, row.old_rank, row.new_rank, row.method, row.team, row.old_mds, row.new_mds, row.difference]
        for row in changes.rows
    ]
    tables = [table("", "old rank", "new rank", "method", "team", "old mDS", "new mDS", "difference", rows=rows)]
    findings = [[one.submission, one.publication, " ".join(one.reasons)] for one in changes.findings]
    if findings:
        tables.append(table("to look at", "publication", "reason", rows=findings))
    return tables


def retry(args: argparse.Namespace, services: Services) -> Outcome:
    """Let what failed be tried again."""
    with services.transaction() as session:
        chosen = submissions.find(session, args.submission).id if args.submission else None
        items = rescoring_decisions.retry(session, record.get_running(session, _phase(session, args)), actor(), chosen)
    data = {"retried": len(items), "sent": _send(services, items)}
    return Outcome(data=data, text=f"{counted(len(items), 'submission waits', 'submissions wait')} again.")


def exclude(args: argparse.Namespace, services: Services) -> Outcome:
    """Let a submission go without a new score: it leaves the leaderboard when the re-scoring is published."""
    with services.transaction() as session:
        submission_id: uuid.UUID = submissions.find(session, args.submission).id
        rescoring = record.get_running(session, _phase(session, args))
        rescoring_decisions.exclude(session, rescoring, submission_id, args.reason, actor())
    return Outcome(data={"excluded": str(submission_id)}, text=f"Excluded {submission_id}.")


def publish(args: argparse.Namespace, services: Services) -> Outcome:
    """Put the new scores in force, for the whole leaderboard at once."""
    with services.transaction() as session:
        phase = _phase(session, args)
        record.lock_phase(session, phase)
        changes = _diff_document(rank_changes(session, phase, record.get_running(session, phase)))
        rescoring = rescoring_decisions.publish(session, phase, actor(), rows=changes["rows"])
        basis = record.describe(session, Basis.of(rescoring))
    text = f"In force: protocol {basis['protocol']}, evaluator {basis['evaluator_version']},"
    return Outcome(
        data={"in_force": basis, "diff": changes}, text=f"{text} ground truth {basis['ground_truth_version']}."
    )


def discard(args: argparse.Namespace, services: Services) -> Outcome:
    """End the re-scoring without effect; its scores are shown to nobody."""
    with services.transaction() as session:
        rescoring = rescoring_decisions.discard(session, _phase(session, args), actor())
    return Outcome(data={"discarded": rescoring.id}, text="Discarded. What ranks is unchanged.")
