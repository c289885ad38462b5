"""`cs3d validate`: check predictions offline, with the same code the server uses.

Exit status: 0 nothing wrong, 1 problems in the predictions, 2 wrong usage.
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from client.report_text import LISTED_PROBLEMS, problem_line
from evaluator.errors import DataError, UsageError

if TYPE_CHECKING:  # everything heavy is imported when the command runs
    from evaluator.ground_truth import ImageList
    from evaluator.intake import Intake
    from evaluator.report import Report


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Declare the command."""
    parser = subparsers.add_parser(
        "validate",
        help="check predictions without scoring them",
        description="Check a folder or zip of predictions and name every problem with its place and its fix.",
    )
    parser.add_argument("predictions", metavar="PRED", type=Path, help="folder or zip with one *.json for each image")
    parser.add_argument(
        "--images",
        metavar="GT_OR_LIST",
        type=Path,
        help="which images there must be: ground truth (folder or zip), an image list (JSON), "
        "or a text file with one image name in each line; without it missing images go unnoticed",
    )
    parser.add_argument("--json", action="store_true", help="print the whole report as JSON")


def run(args: argparse.Namespace) -> int:
    """Validate and print; return 0, or 1 when the predictions have errors."""
    from evaluator.intake import read_predictions  # noqa: PLC0415 - keeps `cs3d --help` fast

    if not args.predictions.exists():
        raise UsageError(f"{args.predictions} does not exist; give a folder or a zip file.")
    images = None if args.images is None else read_image_list(args.images)
    intake = read_predictions(args.predictions, images=images)
    if args.json:
        print(report_json(intake))
    else:
        _print_report(intake.report, str(args.predictions), images_known=images is not None)
    return 0 if intake.report.accepted else 1


def read_image_list(source: Path) -> "ImageList":
    """Read which images there must be from ground truth, from an `ImageList` as JSON or from a text file of names.

    Raises:
        UsageError: It is none of them.
    """
    import msgspec  # noqa: PLC0415 - keeps `cs3d --help` fast

    from evaluator.ground_truth import ImageList, read_ground_truth  # noqa: PLC0415 - likewise

    try:
        if source.is_dir() or source.suffix == ".zip":
            return read_ground_truth(source).image_list()
        data = source.read_bytes()
        if data.lstrip().startswith(b"{"):
            return msgspec.json.decode(data, type=ImageList)
        names = tuple(sorted(set(data.decode("utf-8").split())))
    except (OSError, DataError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"--images {source} cannot be read: {error}") from error
    if not names:
        raise UsageError(f"--images {source} names no image; write one name in each line.")
    return ImageList(images=names, intrinsics_px=(), sensor_from_vehicle=())


def report_json(intake: "Intake") -> str:
    """Return the whole report as JSON, with the verdict and the digest before it."""
    import msgspec  # noqa: PLC0415 - keeps `cs3d --help` fast

    report = msgspec.to_builtins(intake.report)
    document = {"accepted": intake.report.accepted, "sha256": intake.sha256, **report}
    return msgspec.json.format(msgspec.json.encode(document)).decode()


def _print_report(report: "Report", name: str, *, images_known: bool) -> None:
    """Print a table of all problems and below it where they are."""
    from rich.console import Console  # noqa: PLC0415 - not needed for --json
    from rich.table import Table  # noqa: PLC0415 - likewise
    from rich.text import Text  # noqa: PLC0415 - likewise

    console = Console(file=sys.stdout, highlight=False)
    if report.groups:
        table = Table("", "count")
        for heading in ("problem", "fix"):
            table.add_column(heading, overflow="fold")
        for group in report.groups:
            table.add_row(group.severity, str(group.count), Text(f"{group.title}\n{group.code}"), Text(group.fix))
        console.print(table)
    for group in report.groups:
        for number, problem in enumerate(group.problems[:LISTED_PROBLEMS]):
            text = problem_line(problem)
            if text:
                print(f"{group.code}:" if not number else "", f"  {text}", sep="\n" if not number else "")
        if group.count > LISTED_PROBLEMS:
            print(f"  and {group.count - LISTED_PROBLEMS} more")
    print(_verdict(report, name, images_known=images_known))


def _verdict(report: "Report", name: str, *, images_known: bool) -> str:
    """Sum the report up in one line."""
    images = (
        f"{report.images_found} of {report.images_expected} images" if images_known else f"{report.images_found} images"
    )
    verdict = "valid" if report.accepted else "not valid"
    unchecked = "" if images_known else " Missing images were not looked for; give --images."
    return f"{name}: {verdict}, {report.boxes} boxes in {images}.{unchecked}"
