"""`cs3d validate`: check predictions offline, with the same code the server uses.

Exit status: 0 nothing wrong, 1 problems in the predictions, 2 wrong usage.
"""

import argparse
import io
import re
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

from client.report_text import LISTED_PROBLEMS, amount, problem_line
from evaluator.errors import DataError, UsageError

if TYPE_CHECKING:  # everything heavy is imported when the command runs
    from evaluator.ground_truth import ImageList
    from evaluator.intake import Intake
    from evaluator.report import ProblemGroup, Report

_IMAGE_NAME = re.compile(r"[^\s/_]+(?:_[^\s/_]+)*_\d+_\d+")
"""<city>_<sequence>_<frame>."""
_SENSOR_ROWS = 3


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
        if source.is_dir() or zipfile.is_zipfile(source):
            return read_ground_truth(source).image_list()
        data = source.read_bytes()
        if data.lstrip().startswith(b"{"):
            return _checked(msgspec.json.decode(data, type=ImageList), source)
        names = sorted({line.strip() for line in data.decode("utf-8-sig").splitlines()} - {""})
    except (OSError, DataError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"--images {source} cannot be read: {error}") from error
    return _checked(ImageList(images=tuple(names), intrinsics_px=(), sensor_from_vehicle=()), source)


def _checked(images: "ImageList", source: Path) -> "ImageList":
    """Refuse a list that is none, such as any other text."""
    odd = next((name for name in images.images if not _IMAGE_NAME.fullmatch(name)), None)
    if odd is not None:
        message = f"--images {source} holds {odd[:80]!r}; write one <city>_<sequence>_<frame> in each line."
        raise UsageError(message)
    if not images.images:
        raise UsageError(f"--images {source} names no image; write one <city>_<sequence>_<frame> in each line.")
    if len(set(images.images)) < len(images.images):
        raise UsageError(f"--images {source} names an image twice; name each once.")
    counts = {len(images.intrinsics_px), len(images.sensor_from_vehicle)}
    if counts not in ({0}, {len(images.images)}) or any(
        len(rows) != _SENSOR_ROWS for rows in images.sensor_from_vehicle
    ):
        message = (
            f"--images {source}: give intrinsics_px and sensor_from_vehicle (3 x 4) for every image, or both empty."
        )
        raise UsageError(message)
    return images


def report_json(intake: "Intake") -> str:
    """Return the whole report as JSON, with the verdict and the digest before it."""
    import msgspec  # noqa: PLC0415 - keeps `cs3d --help` fast

    report = msgspec.to_builtins(intake.report)
    document = {"accepted": intake.report.accepted, "sha256": intake.sha256, **report}
    return msgspec.json.format(msgspec.json.encode(document)).decode()


def _print_report(report: "Report", name: str, *, images_known: bool) -> None:
    """Print a table of all problems and below it where they are."""
    if report.groups:
        print(_table(report.groups), end="")
    for group in report.groups:
        lines = [line for line in map(problem_line, group.problems[:LISTED_PROBLEMS]) if line]
        if lines:
            print(f"{group.code}:", *lines, sep="\n  ")
        if group.count > LISTED_PROBLEMS:
            print(f"  and {group.count - LISTED_PROBLEMS} more")
    print(_verdict(report, name, images_known=images_known))


def _table(groups: "tuple[ProblemGroup, ...]") -> str:
    """Lay the problems out as wide as the terminal."""
    from rich.console import Console  # noqa: PLC0415 - not needed for --json
    from rich.table import Table  # noqa: PLC0415 - likewise
    from rich.text import Text  # noqa: PLC0415 - likewise

    table = Table("", "count")
    for heading in ("problem", "fix"):
        table.add_column(heading, overflow="fold")
    for group in groups:
        table.add_row(group.severity, str(group.count), Text(f"{group.title}\n{group.code}"), Text(group.fix))
    # Not straight to the output: rich would end the program with status 1 when a pipe's reader is gone.
    text = io.StringIO()
    console = Console(file=text, width=Console().width, highlight=False)
    console.print(table)
    return text.getvalue()


def _verdict(report: "Report", name: str, *, images_known: bool) -> str:
    """Sum the report up in one line."""
    if not report.accepted and not report.images_found and not report.images_expected:
        return f"{name}: not valid, nothing in it was read."
    verdict = "valid" if report.accepted else "not valid"
    unchecked = "" if images_known else " Missing images were not looked for; give --images."
    return f"{name}: {verdict}, {amount(report, images_known=images_known)}.{unchecked}"
