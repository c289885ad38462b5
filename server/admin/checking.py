"""The command `check`: are all promises of the record kept?"""

import argparse

from server import checker
from server.admin.command import REFUSED, Outcome, Subparsers, add, counted, table
from server.services import Services


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    parser = add(subparsers, "check", check)
    parser.add_argument("--quick", action="store_true", help="do not read every blob and compute every score again")


def check(args: argparse.Namespace, services: Services) -> Outcome:
    """Check rows against blobs, trail, ledger and scores computed again; status 1 when something does not hold."""
    violations = checker.check(services, recompute=not args.quick)
    rows = [[found.rule, found.subject, found.detail] for found in violations]
    data = {"violations": [{"rule": rule, "subject": subject, "detail": detail} for rule, subject, detail in rows]}
    if not rows:
        return Outcome(data=data, text="Every promise of the record holds.")
    return Outcome(
        data=data,
        text=counted(len(rows), "promise does", "promises do") + " not hold.",
        tables=[table("rule", "subject", "detail", rows=rows)],
        status=REFUSED,
    )
