"""The command line `cs3d-admin`.

Exit status: 0 done, 1 refused (the reason is on stderr), 2 wrong usage.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import pydantic
import sqlalchemy as sa
import structlog
from rich.console import Console

from evaluator.errors import BenchmarkError
from server.admin import (
    backups,
    benchmarks,
    checking,
    demo,
    installation,
    people,
    phases,
    rescoring,
    submissions,
    trail,
)
from server.admin.command import REFUSED, WRONG_USAGE, Outcome
from server.errors import Conflict
from server.services import Services
from server.settings import Settings


def build_parser() -> argparse.ArgumentParser:
    """Build the parser with every command."""
    parser = argparse.ArgumentParser(
        prog="cs3d-admin", description="Run a Cityscapes 3D benchmark server. Settings: docs/operating.md."
    )
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for part in (installation, people, benchmarks, phases, submissions, rescoring, trail, checking, backups, demo):
        part.add_commands(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status."""
    args = build_parser().parse_args(argv)
    # Found anew for each message: standard error may be another stream by then.
    structlog.configure(logger_factory=lambda *_: structlog.PrintLogger(sys.stderr))
    try:
        settings = Settings(data_dir=Path(args.data_dir)) if args.data_dir else Settings()
    except pydantic.ValidationError as error:
        return _refuse(args, "settings", str(error), WRONG_USAGE)
    try:
        return _run(args, settings)
    except BenchmarkError as error:
        return _refuse(args, error.code, str(error), WRONG_USAGE if error.code == "usage" else REFUSED)
    except sa.exc.OperationalError as error:
        message = f"{error.orig}; start the database or mend CS3D_DATABASE_URL"
        return _refuse(args, "database", message, REFUSED)


def _run(args: argparse.Namespace, settings: Settings) -> int:
    """Carry a command out and print what it gives back."""
    services = Services.from_settings(settings)
    try:
        if args.needs_tables and not sa.inspect(services.engine).has_table("alembic_version"):
            raise Conflict("this installation has no tables yet; run `cs3d-admin init` first")
        outcome: Outcome = args.run(args, services)
    finally:
        services.close()
    if args.json:
        print(json.dumps(outcome.data, indent=2))
        return outcome.status
    console = Console(soft_wrap=True, highlight=False)
    for shown in outcome.tables:
        console.print(shown)
    if outcome.text:
        console.print(outcome.text, markup=False)
    return outcome.status


def _refuse(args: argparse.Namespace, code: str, message: str, status: int) -> int:
    """Say why a command was not carried out."""
    if args.json:
        print(json.dumps({"error": {"code": code, "detail": message}}), file=sys.stderr)
    else:
        print(f"cs3d-admin: {message}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
