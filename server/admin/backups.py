"""Commands that keep the record safe elsewhere and bring it back."""

import argparse
from pathlib import Path

from server import backup as record
from server import database
from server.admin.command import Outcome, Subparsers, add, counted
from server.services import Services


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    taking = add(subparsers, "backup", backup)
    taking.add_argument("folder", type=Path, help="a new folder")
    restoring = add(subparsers, "restore", restore, needs_tables=False)
    restoring.add_argument("folder", type=Path, help="what backup wrote")


def backup(args: argparse.Namespace, services: Services) -> Outcome:
    """Write the whole record and its blobs to a new folder, also while the server works."""
    rows = record.backup(services, args.folder)
    text = f"Wrote {_size(rows)} to {args.folder}."
    return Outcome(data={"folder": str(args.folder), "rows": rows}, text=text)


def restore(args: argparse.Namespace, services: Services) -> Outcome:
    """Fill an empty installation, in either shape, from a backup; checks every digest."""
    services.settings.signing_key()
    database.migrate(services.engine)
    rows = record.restore(services, args.folder)
    text = f"Restored {_size(rows)}. Next: cs3d-admin check"
    return Outcome(data={"folder": str(args.folder), "rows": rows}, text=text)


def _size(rows: dict[str, int]) -> str:
    return f"{counted(sum(rows.values()), 'row')} and {counted(rows['blob'], 'blob')}"
