"""`cs3d evaluate`: score predictions offline, with the same code the server uses."""

import argparse
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # everything heavy is imported when the command runs
    from evaluator.protocol import Protocol
    from evaluator.resampling import Unit
    from evaluator.results import Scores
    from evaluator.statistics import Statistics
    from evaluator.uncertainty import Uncertainty

FORMATS = ("table", "json", "cityscapes")
MOST_DEPTH_BINS_WITH_INTERVALS = 100
"""Every bin is kept of every resample: 0.3 GB for 1525 images."""
OPTIONS = {
    "min_iou": "--min-iou",
    "max_depth_m": "--max-depth",
    "depth_step_m": "--step-size",
    "working_point": "--cw",
    "modal": "--modal",
}
"""Parameter of a protocol -> the option that sets it."""
AUTOMATIC_WORKING_POINT = -1.0
"""The reference's way to ask for the best working point of each class."""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Declare the command."""
    parser = subparsers.add_parser(
        "evaluate",
        help="score predictions against ground truth",
        description="Score predictions against ground truth. GT and PRED are folders or zip files.",
    )
    parser.add_argument(
        "predictions", metavar="PRED", type=Path, help="one *.json for each image; write it before --labels"
    )
    parser.add_argument("--gt", metavar="GT", type=Path, required=True, help="the ground truth, *_gtBbox3d.json")
    parser.add_argument("--labels", metavar="L", nargs="+", help="classes to evaluate (default: the six that rank)")
    parser.add_argument("--min-iou", metavar="F", type=float, help="a match needs an IoU above this (default: 0.7)")
    parser.add_argument("--max-depth", metavar="M", type=int, help="end of the last depth bin in metres (default: 100)")
    parser.add_argument("--step-size", metavar="M", type=int, help="width of a depth bin in metres (default: 5)")
    parser.add_argument("--cw", metavar="C", type=float, help="working point (default: the best of each class)")
    parser.add_argument("--modal", action="store_true", help="match the submitted modal boxes")
    parser.add_argument("--protocol", choices=("cityscapes3d", "paper"), default="cityscapes3d", help="which rules")
    parser.add_argument("--intervals", action="store_true", help="add 95 %% confidence intervals (bootstrap, BCa)")
    add_unit_option(parser)
    parser.add_argument("--lenient", action="store_true", help="skip what the reference skips, and say so")
    parser.add_argument(
        "--format", choices=FORMATS, default="table", help="table, json or the reference's results.json"
    )
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="write there instead of to the terminal")


def add_unit_option(parser: argparse.ArgumentParser) -> None:
    """Declare the option that says what a bootstrap draws."""
    parser.add_argument(
        "--unit",
        choices=("image", "sequence", "city"),
        help="what the bootstrap draws as a whole: images of one drive resemble each other (default: image)",
    )


def run(args: argparse.Namespace) -> int:
    """Evaluate and print; return 0, or 1 when the predictions have problems."""
    from client.offline import evaluate_offline, note_unknown_labels  # noqa: PLC0415 - keeps `cs3d --help` fast
    from client.report_text import report_text  # noqa: PLC0415 - likewise

    protocol = protocol_from(args)
    found = evaluate_offline(args.gt, args.predictions, protocol, lenient=args.lenient)
    if notes := report_text(found.report):
        print(notes, file=sys.stderr)
    if found.scores is None or found.statistics is None:
        return 1
    if args.labels:
        note_unknown_labels(found.statistics)
    uncertainty = _uncertainty(found.statistics, args.unit or "image") if args.intervals else None
    _write(formatted(found.scores, args.format, uncertainty), args.output)
    return 0


def _uncertainty(statistics: "Statistics", unit: "Unit") -> "Uncertainty":
    from evaluator.uncertainty import intervals  # noqa: PLC0415 - seldom needed

    return intervals(statistics, unit=unit)


def protocol_from(args: argparse.Namespace) -> "Protocol":
    """Return the protocol with the parameters given.

    Raises:
        UsageError: A parameter has no meaning.
    """
    from msgspec.structs import replace  # noqa: PLC0415 - keeps `cs3d --help` fast

    from evaluator.errors import UsageError  # noqa: PLC0415 - likewise
    from evaluator.protocol import PROTOCOLS, require_usable  # noqa: PLC0415 - likewise

    given: dict[str, Any] = {
        "labels": args.labels and tuple(args.labels),
        "min_iou": args.min_iou,
        "max_depth_m": args.max_depth,
        "depth_step_m": args.step_size,
        "working_point": None if args.cw == AUTOMATIC_WORKING_POINT else args.cw,
        "modal": args.modal,
    }
    protocol = replace(PROTOCOLS[args.protocol], **{name: value for name, value in given.items() if value is not None})
    try:
        require_usable(protocol)
    except UsageError as error:
        raise UsageError(_by_option(str(error))) from error
    bins = protocol.max_depth_m / protocol.depth_step_m
    _require(
        not args.intervals or bins <= MOST_DEPTH_BINS_WITH_INTERVALS,
        f"--max-depth / --step-size must not exceed {MOST_DEPTH_BINS_WITH_INTERVALS} with --intervals.",
    )
    _require(args.intervals or not args.unit, "--unit says what --intervals draws as a whole; add --intervals.")
    _require(
        not (args.intervals and args.format == "cityscapes"), "the reference's format has no place for --intervals."
    )
    return protocol


def _by_option(message: str) -> str:
    """Name options where a message names parameters."""
    for parameter, option in OPTIONS.items():
        message = re.sub(rf"\b{parameter}\b", option, message)
    return message


def formatted(scores: "Scores", style: str, uncertainty: "Uncertainty | None" = None) -> str:
    """Return the scores as a table, as JSON, or as the reference's JSON, which has no place for intervals."""
    if style == "json":
        return _json(scores, uncertainty)
    if style == "cityscapes":
        import json  # noqa: PLC0415 - not needed for the table

        from evaluator.cityscapes_format import cityscapes_results  # noqa: PLC0415 - likewise

        return json.dumps({**cityscapes_results(scores), "signature": str(scores.signature)}, indent=4)
    from client.score_text import score_table  # noqa: PLC0415 - likewise

    return score_table(scores, uncertainty)


def _json(scores: "Scores", uncertainty: "Uncertainty | None") -> str:
    import msgspec  # noqa: PLC0415 - not needed for the table

    document = {**msgspec.to_builtins(scores), "signature_text": str(scores.signature)}
    if uncertainty is not None:
        document["uncertainty"] = msgspec.to_builtins(uncertainty)
    return msgspec.json.format(msgspec.json.encode(document)).decode()


def _write(text: str, output: Path | None) -> None:
    from evaluator.errors import UsageError  # noqa: PLC0415 - keeps `cs3d --help` fast

    if output is None:
        print(text)
        return
    try:
        output.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"Cannot write {output} ({error.strerror}); choose another -o.") from error


def _require(condition: bool, message: str) -> None:  # noqa: FBT001 - reads as a sentence at every call
    from evaluator.errors import UsageError  # noqa: PLC0415 - keeps `cs3d --help` fast

    if not condition:
        raise UsageError(message)
