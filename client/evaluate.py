"""`cs3d evaluate`: score predictions offline, with the same code the server uses."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from client.options import (
    add_draw_options,
    add_protocol_choice,
    add_protocol_options,
    draw_from,
    draw_options_given,
    protocol_from,
)

if TYPE_CHECKING:  # everything heavy is imported when the command runs
    from client.options import Draw
    from evaluator.protocol import Protocol
    from evaluator.results import Scores
    from evaluator.statistics import Statistics
    from evaluator.uncertainty import Method, Uncertainty

FORMATS = ("table", "json", "cityscapes")
MOST_DEPTH_BINS_WITH_INTERVALS = 100
"""Every bin is kept of every resample: 0.3 GB for 1525 images."""


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
    add_protocol_choice(parser)
    add_protocol_options(parser)
    parser.add_argument("--intervals", action="store_true", help="add confidence intervals (bootstrap)")
    add_draw_options(parser)
    parser.add_argument(
        "--method", choices=("bca", "percentile"), help="how an interval follows from the resamples (default: bca)"
    )
    parser.add_argument("--lenient", action="store_true", help="skip what the reference skips, and say so")
    parser.add_argument(
        "--format", choices=FORMATS, default="table", help="table, json or the reference's results.json"
    )
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="write there instead of to the terminal")


def run(args: argparse.Namespace) -> int:
    """Evaluate and print; return 0, or 1 when the predictions have problems."""
    from client.offline import evaluate_offline, note_unknown_labels  # noqa: PLC0415 - keeps `cs3d --help` fast
    from client.report_text import report_text  # noqa: PLC0415 - likewise

    protocol = protocol_from(args)
    _require_sense(args, protocol)
    draw = draw_from(args) if args.intervals else None
    found = evaluate_offline(args.gt, args.predictions, protocol, lenient=args.lenient)
    if notes := report_text(found.report):
        print(notes, file=sys.stderr)
    if found.scores is None or found.statistics is None:
        return 1
    if args.labels:
        note_unknown_labels(found.statistics)
    uncertainty = _uncertainty(found.statistics, draw, args.method or "bca") if draw else None
    _write(formatted(found.scores, args.format, uncertainty), args.output)
    return 0


def _uncertainty(statistics: "Statistics", draw: "Draw", method: "Method") -> "Uncertainty":
    from dataclasses import asdict  # noqa: PLC0415 - seldom needed

    from evaluator.uncertainty import intervals  # noqa: PLC0415 - likewise

    return intervals(statistics, method=method, **asdict(draw))


def _require_sense(args: argparse.Namespace, protocol: "Protocol") -> None:
    """Refuse options that do not go together.

    Raises:
        UsageError: Some do not.
    """
    bins = protocol.max_depth_m / protocol.depth_step_m
    _require(
        not args.intervals or bins <= MOST_DEPTH_BINS_WITH_INTERVALS,
        f"--max-depth / --step-size must not exceed {MOST_DEPTH_BINS_WITH_INTERVALS} with --intervals.",
    )
    about_intervals = [*draw_options_given(args), *(["--method"] if args.method else [])]
    _require(args.intervals or not about_intervals, f"{', '.join(about_intervals)}: nothing is drawn; add --intervals.")
    _require(
        not (args.intervals and args.format == "cityscapes"), "the reference's format has no place for --intervals."
    )


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
