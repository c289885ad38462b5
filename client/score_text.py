"""Scores as a plain table for the terminal, in percent. The only place of the client that rounds."""

from evaluator.results import Scores

_COLUMNS = ("class", "boxes", "AP", "BEVCD", "YawSim", "PRSim", "SizeSim", "DS", "c_w")
_UNDEFINED = "n/a"


def score_table(scores: Scores) -> str:
    """Return one row for each class, the means below, and the signature as the last line."""
    rows = [
        (
            item.label,
            str(item.ground_truth_count),
            *map(_percent, (item.ap, item.bevcd, item.yaw_sim, item.pr_sim, item.size_sim, item.detection_score)),
            _UNDEFINED if item.working_point is None else f"{item.working_point:.2f}",
        )
        for item in scores.classes
    ]
    means = (scores.map, scores.mbevcd, scores.myaw_sim, scores.mpr_sim, scores.msize_sim, scores.mds)
    boxes = sum(item.ground_truth_count for item in scores.classes)
    mean = ("mean", str(boxes), *map(_percent, means), "")
    return "\n".join([*_aligned([_COLUMNS, *rows, mean]), "", f"mDS {_percent(scores.mds)}  {scores.signature}"])


def _percent(value: float | None) -> str:
    return _UNDEFINED if value is None else f"{100 * value:.2f}"


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    first, *rest = widths
    lines = [
        "  ".join(
            [row[0].ljust(first), *(cell.rjust(width) for cell, width in zip(row[1:], rest, strict=True))]
        ).rstrip()
        for row in rows
    ]
    rule = "-" * (sum(widths) + 2 * len(rest))
    return [lines[0], rule, *lines[1:-1], rule, lines[-1]]
