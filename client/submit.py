"""`cs3d submit`: upload predictions to a benchmark server.

Exit status: 0 received (with --wait: scored), 1 refused, rejected or failed, 2 wrong usage.
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from evaluator.errors import UsageError

if TYPE_CHECKING:  # everything heavy is imported when the command runs
    from client.server_api import Server

FIELDS = ("benchmark", "phase", "method", "method_name", "description", "paper_url", "code_url")


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Declare the command."""
    parser = subparsers.add_parser(
        "submit",
        help="upload predictions to a benchmark server",
        description="Upload a zip of predictions to a benchmark server.",
    )
    parser.add_argument("predictions", metavar="ZIP", type=Path, help="zip with one *.json for each image")
    parser.add_argument("--benchmark", metavar="B", required=True)
    parser.add_argument("--phase", metavar="P", required=True)
    parser.add_argument("--method", metavar="M", required=True, help="short name; a new one makes a new method")
    parser.add_argument(
        "--method-name",
        metavar="NAME",
        help="the method's name as shown on the leaderboard (default: the one it has, else M)",
    )
    parser.add_argument("--description", metavar="TEXT", help="what the method is")
    parser.add_argument("--paper-url", metavar="URL", help="where the method's paper is")
    parser.add_argument("--code-url", metavar="URL", help="where its code is")
    parser.add_argument("--check", action="store_true", help="validate before sending; send nothing with errors in it")
    parser.add_argument("--wait", action="store_true", help="wait for the scores and print them")
    add_server_options(parser)


def add_server_options(parser: argparse.ArgumentParser) -> None:
    """Declare what every command that speaks to a server takes."""
    parser.add_argument("--server", metavar="URL", help="default: the environment variable CS3D_SERVER")
    parser.add_argument("--token", metavar="T", help="API token; better: the environment variable CS3D_TOKEN")
    parser.add_argument("--json", action="store_true", help="print the submission as JSON")


def run(args: argparse.Namespace) -> int:
    """Upload, and wait if asked to."""
    from client.watch import conclude, explain_refusal  # noqa: PLC0415 - keeps `cs3d --help` fast

    server = connect(args)
    if not args.predictions.is_file():
        message = f"{args.predictions} is not a file; pack the prediction files into one zip."
        raise UsageError(message)
    with explain_refusal():
        if args.check and not _passes_validation(args.predictions, server.images(args.benchmark, args.phase)):
            return 1
    fields = {name: getattr(args, name) for name in FIELDS}
    with explain_refusal(), _progress(args.predictions, quiet=args.json) as sent:
        given = {name: value for name, value in fields.items() if value is not None}
        submission = server.submit(args.predictions, given, sent)
    if args.wait:
        return conclude(server, submission["id"], as_json=args.json)
    if args.json:
        print(json.dumps(submission, indent=2))
    else:
        print(f"Received as submission {submission['id']}: {server.address(submission['links']['page'])}")
        print(f"Follow it with: cs3d watch {submission['id']}")
    return 0


def connect(args: argparse.Namespace) -> "Server":
    """Name the server and the token, from the options or the environment.

    Raises:
        UsageError: One of them is missing or cannot be one.
    """
    from client.server_api import Server  # noqa: PLC0415 - keeps `cs3d --help` fast

    url = args.server or os.environ.get("CS3D_SERVER")
    token = args.token or os.environ.get("CS3D_TOKEN")
    if not url:
        raise UsageError("no server: give --server URL or set CS3D_SERVER.")
    if not token:
        raise UsageError("no token: set CS3D_TOKEN or give --token; make one on your account page.")
    return Server(url, token)


def _passes_validation(predictions: Path, image_list: bytes) -> bool:
    """Validate and print what is wrong; the image list is the phase's, as JSON."""
    import msgspec  # noqa: PLC0415 - keeps `cs3d --help` fast

    from client.report_text import report_text  # noqa: PLC0415 - likewise
    from evaluator.ground_truth import ImageList  # noqa: PLC0415 - likewise
    from evaluator.intake import read_predictions  # noqa: PLC0415 - likewise
    from evaluator.limits import ANY_SIZE  # noqa: PLC0415 - likewise

    # How large an archive may be is the server's to say.
    images = msgspec.json.decode(image_list, type=ImageList)
    report = read_predictions(predictions, images=images, limits=ANY_SIZE).report
    if report.groups:
        print(report_text(report), file=sys.stderr)
    return report.accepted


@contextmanager
def _progress(predictions: Path, *, quiet: bool) -> Iterator[Callable[[int], None]]:
    """Show how much is sent, on a terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console  # noqa: PLC0415 - not needed in scripts
    from rich.progress import BarColumn, DownloadColumn, Progress, TransferSpeedColumn  # noqa: PLC0415 - likewise

    columns = ("uploading", BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=predictions.stat().st_size)
        yield lambda sent: bar.update(task, completed=sent)
