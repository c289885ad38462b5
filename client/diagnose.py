"""`cs3d diagnose`: why predictions score what they score, and what other benchmarks would say."""

import argparse
from pathlib import Path

from client.options import add_protocol_options, protocol_from


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Declare the command."""
    parser = subparsers.add_parser(
        "diagnose",
        help="explain a score: errors in metres, causes, oracles, calibration",
        description="Explain the score of predictions. GT and PRED are folders or zip files.",
    )
    parser.add_argument("predictions", metavar="PRED", type=Path, help="one *.json for each image")
    parser.add_argument("--gt", metavar="GT", type=Path, required=True, help="the ground truth, *_gtBbox3d.json")
    add_protocol_options(parser)
    parser.add_argument("--lenient", action="store_true", help="skip what the reference skips, and say so")
    parser.add_argument(
        "--class",
        dest="label",
        metavar="L",
        help="show errors and kinds of objects of one class (JSON has every class)",
    )
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    parser.add_argument(
        "--benchmarks", action="store_true", help="add what KITTI, nuScenes, Waymo and Argoverse 2 would say"
    )


def run(args: argparse.Namespace) -> int:
    """Evaluate, explain and print; return 0, or 1 when the predictions have problems."""
    from client.offline import evaluate_fully  # noqa: PLC0415 - keeps `cs3d --help` fast

    evaluations = evaluate_fully([args.predictions], args.gt, protocol_from(args), lenient=args.lenient)
    if evaluations is None:
        return 1
    from evaluator.diagnosis.diagnose import diagnose  # noqa: PLC0415 - keeps `cs3d --help` fast

    evaluation = evaluations[0]
    diagnosis, comparison = diagnose(evaluation), None
    if args.benchmarks:
        from evaluator.comparison.summary import comparison_metrics  # noqa: PLC0415 - loads shapely

        signature = evaluation.scores.signature
        comparison = comparison_metrics(
            evaluation.ground_truth,
            evaluation.predictions,
            ground_truth_sha256=signature.ground_truth_sha256,
            predictions_sha256=signature.predictions_sha256,
        )
    if args.json:
        import msgspec  # noqa: PLC0415 - not needed for the tables

        document = {"diagnosis": diagnosis, "comparison": comparison}
        print(msgspec.json.format(msgspec.json.encode(document)).decode())
        return 0
    from client.diagnosis_text import diagnosis_text  # noqa: PLC0415 - not needed for JSON

    print(diagnosis_text(evaluation.scores, diagnosis, args.label))
    if comparison is not None:
        from client.benchmarks_text import benchmarks_text  # noqa: PLC0415 - likewise

        print("\n" + benchmarks_text(comparison))
    return 0
