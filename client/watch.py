"""`cs3d watch`: follow a submission until it is scored, rejected or failed.

Exit status: 0 scored, 1 anything else, 2 wrong usage.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from client.submit import add_server_options, connect

if TYPE_CHECKING:  # everything heavy is imported when the command runs
    from client.server_api import Server


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Declare the command."""
    parser = subparsers.add_parser(
        "watch",
        help="follow a submission to its scores",
        description="Follow a submission until nothing changes any more, and print its scores or its report.",
    )
    parser.add_argument("submission", metavar="ID")
    add_server_options(parser)


def run(args: argparse.Namespace) -> int:
    """Follow and print."""
    with explain_refusal():
        return conclude(connect(args), args.submission, as_json=args.json)


def conclude(server: "Server", submission_id: str, *, as_json: bool) -> int:
    """Follow a submission to its end and print what became of it."""
    document: dict[str, Any] = {}
    for document in server.follow(submission_id):
        print(_state_line(document), file=sys.stderr)
    if as_json:
        results = json.loads(server.results(submission_id)) if document["state"] == "scored" else None
        print(json.dumps({**document, "results": results}, indent=2))
    elif document["state"] == "scored":
        print(_scores(server.results(submission_id)))
    else:
        _explain(document)
    return 0 if document["state"] == "scored" else 1


def _state_line(document: dict[str, Any]) -> str:
    """Say on one line where a submission is."""
    progress = document.get("progress")
    if not progress or not progress["images_total"] or document["terminal"]:
        return str(document["state"])
    return f"{document['state']}: {progress['stage']} {progress['images_done']} of {progress['images_total']} images"


def _scores(results: bytes) -> str:
    """Write scores down as a table."""
    import msgspec  # noqa: PLC0415 - keeps `cs3d --help` fast

    from client.score_text import score_table  # noqa: PLC0415 - likewise
    from evaluator.results import Scores  # noqa: PLC0415 - likewise

    return score_table(msgspec.json.decode(results, type=Scores))


def _explain(document: dict[str, Any]) -> None:
    """Print why a submission has no scores."""
    if document.get("report"):
        _print_report(document["report"])
    if document.get("failure"):
        print(f"{document['failure']['code']}: {document['failure']['detail']}", file=sys.stderr)


def _print_report(report: dict[str, Any]) -> None:
    """Print a report that came as JSON."""
    import msgspec  # noqa: PLC0415 - keeps `cs3d --help` fast

    from client.report_text import report_text  # noqa: PLC0415 - likewise
    from evaluator.report import Report  # noqa: PLC0415 - likewise

    print(report_text(msgspec.convert(report, type=Report)), file=sys.stderr)


@contextmanager
def explain_refusal() -> Iterator[None]:
    """Print the report that a refusal carries, before the refusal itself is said."""
    from client.server_api import ServerRefused  # noqa: PLC0415 - keeps `cs3d --help` fast

    try:
        yield
    except ServerRefused as refusal:
        if refusal.document.get("report"):
            _print_report(refusal.document["report"])
        raise
