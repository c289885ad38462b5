"""Commands about benchmarks, phases, ground truth and quota."""

import argparse
from datetime import UTC, datetime
from pathlib import Path

from evaluator.errors import UsageError
from evaluator.protocol import CITYSCAPES3D, PROTOCOLS
from server import accounts, quota
from server import benchmarks as record
from server.admin.command import Outcome, Subparsers, actor, add
from server.services import Services

SHARDS_HELP = "ranges of images that several workers match at once; 1: submissions are scored in one piece"


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    benchmark = add(subparsers, "create-benchmark", create_benchmark)
    benchmark.add_argument("benchmark", help="short name for addresses, for example cityscapes3d")
    benchmark.add_argument("--title", required=True)
    benchmark.add_argument("--description", default="")
    phase = add(subparsers, "create-phase", create_phase)
    _add_phase(phase)
    phase.add_argument("--title", required=True)
    phase.add_argument("--open", action="store_true", help="its ground truth is public, for example val")
    phase.add_argument("--no-publication", action="store_true", help="no leaderboard: scores stay with their team")
    phase.add_argument("--opens-at", type=_time, metavar="TIME", help="ISO 8601, UTC unless it says otherwise")
    phase.add_argument("--closes-at", type=_time, metavar="TIME")
    phase.add_argument("--submissions-per-day", type=int, default=10, metavar="N")
    phase.add_argument("--rejections-per-day", type=int, default=50, metavar="N")
    phase.add_argument("--max-attempts", type=int, default=3, metavar="N", help="workers lost before one fails")
    phase.add_argument("--shards", type=int, default=1, metavar="N", help=SHARDS_HELP)
    phase.add_argument("--protocol", choices=sorted(PROTOCOLS), default=CITYSCAPES3D.name)
    ground_truth = add(subparsers, "import-ground-truth", import_ground_truth)
    _add_phase(ground_truth)
    ground_truth.add_argument("source", type=Path, help="folder or zip of <city>_<sequence>_<frame>_gtBbox3d.json")
    shards = add(subparsers, "set-shards", set_shards)
    _add_phase(shards)
    shards.add_argument("shards", type=int, help=SHARDS_HELP)
    grant = add(subparsers, "grant", grant_quota)
    _add_phase(grant)
    grant.add_argument("team")
    grant.add_argument("count", type=int, help="submissions more than the phase allows")
    grant.add_argument("--reason", required=True, help="kept in the ledger")


def _add_phase(parser: argparse.ArgumentParser) -> None:
    """Add the two arguments that name a phase."""
    parser.add_argument("benchmark")
    parser.add_argument("phase")


def _time(text: str) -> datetime:
    """Read a time; one without a zone is UTC."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError as error:
        message = f"{text!r} is not an ISO 8601 time like 2027-03-01T12:00"
        raise argparse.ArgumentTypeError(message) from error
    return time if time.tzinfo else time.replace(tzinfo=UTC)


def create_benchmark(args: argparse.Namespace, services: Services) -> Outcome:
    """Create a benchmark without phases."""
    with services.transaction() as session:
        benchmark = record.create_benchmark(
            session, slug=args.benchmark, title=args.title, description=args.description, actor=actor()
        )
        data = {"id": benchmark.id, "benchmark": benchmark.slug, "title": benchmark.title}
    return Outcome(
        data=data, text=f"Created benchmark {args.benchmark}. Next: cs3d-admin create-phase {args.benchmark} ..."
    )


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


def set_shards(args: argparse.Namespace, services: Services) -> Outcome:
    """Choose into how many ranges of images the submissions of a phase are divided."""
    with services.transaction() as session:
        phase = record.find_phase(session, args.benchmark, args.phase)
        record.set_shards(session, phase, args.shards, actor=actor())
    data = {"benchmark": args.benchmark, "phase": args.phase, "shards": args.shards}
    text = f"Submissions to {args.benchmark}/{args.phase} are scored in {args.shards} shards from their next claim on."
    return Outcome(data=data, text=text)


def import_ground_truth(args: argparse.Namespace, services: Services) -> Outcome:
    """Validate ground truth and make it the phase's next version."""
    if not args.source.exists():
        message = f"{args.source} does not exist; give a folder or a zip"
        raise UsageError(message)
    prepared = record.prepare_ground_truth(services.blobs, args.source)
    with services.transaction() as session:
        phase = record.find_phase(session, args.benchmark, args.phase)
        version = record.add_ground_truth(session, services.blobs, phase=phase, prepared=prepared, actor=actor())
        in_force = record.enforce_if_possible(session, phase, version, actor=actor())
        data = {
            "benchmark": args.benchmark,
            "phase": args.phase,
            "version": version.version,
            "sha256": version.sha256,
            "images": version.image_count,
            "boxes": version.box_count,
            "in_force": in_force,
        }
    place = f"{args.benchmark} {args.phase} --version {data['version']}"
    standing = "in force" if in_force else f"not in force yet. Next: cs3d-admin rescore start {place}"
    text = f"Imported version {version.version}: {version.image_count} images, {version.box_count} boxes; {standing}"
    return Outcome(data=data, text=text)


def grant_quota(args: argparse.Namespace, services: Services) -> Outcome:
    """Allow a team more submissions in a phase."""
    with services.transaction() as session:
        team = accounts.find_team(session, args.team)
        phase = record.find_phase(session, args.benchmark, args.phase)
        quota.grant(session, team=team, phase=phase, count=args.count, reason=args.reason, actor=actor())
    data = {"team": args.team, "benchmark": args.benchmark, "phase": args.phase, "granted": args.count}
    return Outcome(data=data, text=f"Team {args.team} may send {args.count} more to {args.benchmark}/{args.phase}.")
