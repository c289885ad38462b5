"""`cs3d compare`: where the difference of two submissions comes from, and whether it can be chance."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from client.options import add_draw_options, add_protocol_choice, add_protocol_options, draw_from, protocol_from

if TYPE_CHECKING:  # everything heavy is imported when the command runs
    from client.options import Draw
    from evaluator.diagnosis.difference import Difference
    from evaluator.protocol import Protocol
    from evaluator.uncertainty import Comparison


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Declare the command."""
    parser = subparsers.add_parser(
        "compare",
        help="split the difference of two submissions",
        description="Split the difference of two submissions, second minus first. GT and PRED are folders or zip files.",
    )
    parser.add_argument("first", metavar="PRED_A", type=Path)
    parser.add_argument("second", metavar="PRED_B", type=Path)
    parser.add_argument("--gt", metavar="GT", type=Path, required=True, help="the ground truth, *_gtBbox3d.json")
    add_protocol_choice(parser)
    add_protocol_options(parser)
    add_draw_options(parser)
    parser.add_argument("--lenient", action="store_true", help="skip what the reference skips, and say so")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: argparse.Namespace) -> int:
    """Evaluate both, compare and print; return 0, or 1 when the predictions of either have problems."""
    from client.offline import evaluate_fully  # noqa: PLC0415 - keeps `cs3d --help` fast

    draw = draw_from(args)
    evaluations = evaluate_fully([args.first, args.second], args.gt, protocol_from(args), lenient=args.lenient)
    if evaluations is None:
        return 1
    from evaluator.diagnosis.difference import explain_difference  # noqa: PLC0415 - likewise
    from evaluator.uncertainty import compare  # noqa: PLC0415 - likewise

    first, second = evaluations
    difference = explain_difference(first.scores, second.scores)
    paired = compare(second.statistics, first.statistics, **asdict(draw))
    if args.json:
        import msgspec  # noqa: PLC0415 - not needed for the table

        document = {"difference": difference, "paired": paired}
        print(msgspec.json.format(msgspec.json.encode(document)).decode())
        return 0
    print(difference_text(difference, paired.means["mds"], draw))
    return 0


def difference_text(difference: "Difference", paired: "Comparison | None", draw: "Draw") -> str:
    """Return the split as a table, in percent points, below it what explains it, and both signatures last."""
    from client.score_text import zeroed_note  # noqa: PLC0415 - not needed for JSON
    from client.text_table import percent, points, text_table  # noqa: PLC0415 - likewise
    from evaluator.diagnosis.loss import PARTS  # noqa: PLC0415 - likewise
    from evaluator.resampling import UNITS  # noqa: PLC0415 - likewise

    lines = [(part.label, part.parts, part.total) for part in difference.classes]
    rows = [
        (label, *(points(getattr(parts, name, None)) for name in PARTS), points(total))
        for label, parts, total in [*lines, ("all", difference.parts, difference.total)]
    ]
    header = ("class", "AP", "BEVCD", "YawSim", "PRSim", "SizeSim", "total")
    title = f"mDS {percent(difference.mds[0])} -> {percent(difference.mds[1])}: points of mDS by class and part"
    zeroed = zip(("first", "second"), difference.zeroed_labels, strict=True)
    notes = [f"In the {place} submission {zeroed_note(labels)}" for place, labels in zeroed if labels]
    said = _chance_text(paired, draw, difference.signatures[0].protocol)
    chance = f"Paired bootstrap over {UNITS[draw.unit]}: {said}"
    signatures = "\n".join(map(str, difference.signatures))
    return "\n\n".join([text_table(title, header, rows), *notes, chance, signatures])


def _chance_text(paired: "Comparison | None", draw: "Draw", protocol: "Protocol") -> str:
    """Say whether the difference can be chance."""
    from client.text_table import points  # noqa: PLC0415 - not needed for JSON
    from evaluator.interval_rules import can_be_resampled  # noqa: PLC0415 - likewise
    from evaluator.resampling import UNITS  # noqa: PLC0415 - likewise

    if paired is None and not can_be_resampled(protocol).all():
        return f"n/a, resamples do not scatter about the mDS of the protocol {protocol.name}."
    if paired is None:
        return f"n/a, there are too few {UNITS[draw.unit]} or boxes of a class for it."
    interval = paired.difference
    doubt = "" if interval.is_proven else f"; unproven: too few {UNITS[draw.unit]} or boxes of a class"
    return (
        f"difference {points(interval.estimate)}, {100 * draw.level:g} % interval "
        f"[{points(interval.lower)}, {points(interval.upper)}], p = {paired.p_value:.3f}{doubt}"
    )
