"""Commands about phases and their rules."""

import argparse
from datetime import UTC, datetime
from typing import Any, cast

from evaluator.errors import UsageError
from evaluator.protocol import CITYSCAPES3D, PROTOCOLS
from server import benchmarks as record
from server.admin.command import Outcome, Subparsers, actor, add, add_phase, counted
from server.admin.listing import listing
from server.models import Phase
from server.phase_rules import PhaseRules, rules_of
from server.services import Services

SHARDS_HELP = "ranges of images that several workers match at once; 1: submissions are scored in one piece"
NO_TIME = "none"
"""Takes a date away."""


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    created = add(subparsers, "create-phase", create_phase)
    add_phase(created)
    created.add_argument("--title", required=True)
    created.add_argument("--open", action="store_true", help="its ground truth is public, for example val")
    created.add_argument("--no-publication", action="store_true", help="no leaderboard: scores stay with their team")
    created.add_argument("--opens-at", type=_time, metavar="TIME", help="ISO 8601, UTC unless it says otherwise")
    created.add_argument("--closes-at", type=_time, metavar="TIME")
    created.add_argument("--submissions-per-day", type=int, default=10, metavar="N")
    created.add_argument("--rejections-per-day", type=int, default=50, metavar="N")
    created.add_argument("--max-attempts", type=int, default=3, metavar="N", help="workers lost before one fails")
    created.add_argument("--shards", type=int, default=1, metavar="N", help=SHARDS_HELP)
    created.add_argument("--protocol", choices=sorted(PROTOCOLS), default=CITYSCAPES3D.name)
    _add_editing(subparsers)
    listed = add(subparsers, "list-phases", list_phases)
    listed.add_argument("--benchmark", help="of this one alone")
    shards = add(subparsers, "set-shards", set_shards)
    add_phase(shards)
    shards.add_argument("shards", type=int, help=SHARDS_HELP)


def _add_editing(subparsers: Subparsers) -> None:
    """Add edit-phase. What is not given has no attribute: None takes a date away."""
    edited = add(subparsers, "edit-phase", edit_phase)
    add_phase(edited)

    def option(*names: str, rule: str, **how: Any) -> None:  # noqa: ANN401 - what argparse takes
        edited.add_argument(*names, dest=rule, default=argparse.SUPPRESS, **how)

    yes_or_no = argparse.BooleanOptionalAction
    option("--title", rule="title")
    option("--open", rule="is_open", action=yes_or_no, help="its ground truth is public")
    option("--publication", rule="allows_publication", action=yes_or_no, help="scores may be published")
    time_help = "ISO 8601, UTC unless it says otherwise; none: it has no such date"
    option("--opens-at", rule="opens_at", type=_time_or_none, metavar="TIME", help=time_help)
    option("--closes-at", rule="closes_at", type=_time_or_none, metavar="TIME", help="likewise")
    option("--submissions-per-day", rule="submissions_per_day", type=int, metavar="N")
    option("--rejections-per-day", rule="rejections_per_day", type=int, metavar="N")
    option("--max-attempts", rule="max_attempts", type=int, metavar="N", help="workers lost before one fails")


def _time(text: str) -> datetime:
    """Read a time; one without a zone is UTC."""
    try:
        time = datetime.fromisoformat(text)
        return time.astimezone(UTC) if time.tzinfo else time.replace(tzinfo=UTC)
    except (ValueError, OverflowError) as error:
        message = f"{text!r} is not an ISO 8601 time like 2027-03-01T12:00"
        raise argparse.ArgumentTypeError(message) from error


def _time_or_none(text: str) -> datetime | None:
    """Read a time or that there is none."""
    return None if text == NO_TIME else _time(text)


def create_phase(args: argparse.Namespace, services: Services) -> Outcome:
    """Create a phase; it takes submissions once it has ground truth."""
    with services.transaction() as session:
        phase = record.create_phase(
            session,
            benchmark=record.find_benchmark(session, args.benchmark),
            slug=args.phase,
            title=args.title,
            protocol=args.protocol,
            is_open=args.open,
            allows_publication=not args.no_publication,
            opens_at=args.opens_at,
            closes_at=args.closes_at,
            submissions_per_day=args.submissions_per_day,
            rejections_per_day=args.rejections_per_day,
            max_attempts=args.max_attempts,
            shards=args.shards,
            actor=actor(),
        )
        data = {"id": phase.id, "benchmark": args.benchmark, "phase": phase.slug, "protocol": phase.protocol}
    place = f"{args.benchmark} {args.phase}"
    return Outcome(data=data, text=f"Created phase {args.phase}. Next: cs3d-admin import-ground-truth {place} FOLDER")


def edit_phase(args: argparse.Namespace, services: Services) -> Outcome:
    """Change rules of a phase from now on: its title, dates, quotas, whether it has a leaderboard."""
    given = {name: value for name, value in vars(args).items() if name in PhaseRules.__annotations__}
    if not given:
        raise UsageError("say what to change, for example --closes-at 2027-03-01T12:00; --help lists the options")
    with services.transaction() as session:
        phase = record.find_phase(session, args.benchmark, args.phase)
        changed = record.edit_phase(session, phase, actor=actor(), **cast("PhaseRules", given))
    data = {"benchmark": args.benchmark, "phase": args.phase, "changed": changed}
    place = f"{args.benchmark}/{args.phase}"
    if not changed:
        return Outcome(data=data, text=f"{place} has these rules already; nothing was changed.")
    listed = ", ".join(f"{name} is {NO_TIME if value is None else value}" for name, value in changed.items())
    return Outcome(data=data, text=f"Changed {place}: {listed}.")


def list_phases(args: argparse.Namespace, services: Services) -> Outcome:
    """List the phases with their rules, what ranks in them and into how many shards submissions are divided."""
    with services.snapshot() as session:
        chosen = record.list_benchmarks(session)
        if args.benchmark is not None:
            chosen = [record.find_benchmark(session, args.benchmark)]
        rows = [_described(benchmark.slug, phase) for benchmark in chosen for phase in benchmark.phases]
    return listing("phases", rows)


def _described(benchmark: str, phase: Phase) -> dict[str, Any]:
    """Describe a phase; its id is what the audit trail calls it by."""
    return {
        "id": phase.id,
        "benchmark": benchmark,
        "phase": phase.slug,
        "ground_truth_version": phase.ground_truth.version if phase.ground_truth else None,
        "protocol": phase.protocol,
        "shards": phase.shards,
        **rules_of(phase),
    }


def set_shards(args: argparse.Namespace, services: Services) -> Outcome:
    """Choose into how many ranges of images the submissions of a phase are divided."""
    with services.transaction() as session:
        phase = record.find_phase(session, args.benchmark, args.phase)
        record.set_shards(session, phase, args.shards, actor=actor())
    data = {"benchmark": args.benchmark, "phase": args.phase, "shards": args.shards}
    shards = counted(args.shards, "shard")
    text = f"Submissions to {args.benchmark}/{args.phase} are scored in {shards} from their next claim on."
    return Outcome(data=data, text=text)
