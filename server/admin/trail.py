"""The command `audit`: what happened, who did it and when."""

import argparse

from evaluator.errors import UsageError
from server import audit as record
from server.admin.command import Outcome, Subparsers, add
from server.admin.listing import add_limit, listing
from server.models import Base
from server.services import Services


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    parser = add(subparsers, "audit", audit)
    parser.add_argument(
        "--subject", metavar="KIND:ID", help="of this alone: submission:ID, phase:ID, user_account:ID, ..."
    )
    parser.add_argument("--action", help="this alone, for example submission.held, or a kind of them: submission")
    add_limit(parser)


def audit(args: argparse.Namespace, services: Services) -> Outcome:
    """Print the audit trail, newest first; with --json every event's whole detail."""
    if args.subject is not None and args.subject.partition(":")[0] not in Base.metadata.tables:
        message = (
            f"{args.subject!r} names nothing in the trail; give submission:ID, phase:ID, team:ID, user_account:ID,"
            " token:ID, method:ID, benchmark:ID or score:ID with an id that a list or the trail shows"
        )
        raise UsageError(message)
    with services.snapshot() as session:
        events = record.latest(session, subject=args.subject, action=args.action, limit=args.limit + 1)
        rows = [
            {
                "id": event.id,
                "at": event.at,
                "actor": event.actor,
                "action": event.action,
                "subject": event.subject,
                "detail": event.detail,
            }
            for event in events
        ]
    return listing("events", rows, limit=args.limit)
