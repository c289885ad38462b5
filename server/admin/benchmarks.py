"""Commands about benchmarks, ground truth and quota."""

import argparse
from pathlib import Path

from evaluator.errors import UsageError
from server import accounts, quota
from server import benchmarks as record
from server.admin.command import Outcome, Subparsers, actor, add, add_phase, counted, whole_number
from server.phase_rules import MOST_IN_A_RULE
from server.services import Services


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    benchmark = add(subparsers, "create-benchmark", create_benchmark)
    benchmark.add_argument("benchmark", help="short name for addresses, for example cityscapes3d")
    benchmark.add_argument("--title", required=True)
    benchmark.add_argument("--description", default="")
    ground_truth = add(subparsers, "import-ground-truth", import_ground_truth)
    add_phase(ground_truth)
    ground_truth.add_argument("source", type=Path, help="folder or zip of <city>_<sequence>_<frame>_gtBbox3d.json")
    grant = add(subparsers, "grant", grant_quota)
    add_phase(grant)
    grant.add_argument("team")
    grant.add_argument("count", type=whole_number(1, MOST_IN_A_RULE), help="submissions more than the phase allows")
    grant.add_argument("--reason", required=True, help="kept in the ledger")


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
    size = f"{counted(data['images'], 'image')}, {counted(data['boxes'], 'box', 'boxes')}"
    text = f"Imported version {data['version']}: {size}; {standing}"
    return Outcome(data=data, text=text)


def grant_quota(args: argparse.Namespace, services: Services) -> Outcome:
    """Allow a team more submissions in a phase."""
    with services.transaction() as session:
        team = accounts.find_team(session, args.team)
        phase = record.find_phase(session, args.benchmark, args.phase)
        quota.grant(session, team=team, phase=phase, count=args.count, reason=args.reason, actor=actor())
    data = {"team": args.team, "benchmark": args.benchmark, "phase": args.phase, "granted": args.count}
    return Outcome(data=data, text=f"Team {args.team} may send {args.count} more to {args.benchmark}/{args.phase}.")
