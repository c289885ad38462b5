"""Scores as a table for the terminal, in percent."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from client.text_table import UNDEFINED, aligned, number, percent
from evaluator.interval_rules import can_be_resampled
from evaluator.replicates import MEANS, METRICS
from evaluator.resampling import UNITS
from evaluator.results import Scores

if TYPE_CHECKING:  # slow to import and seldom needed
    from evaluator.confidence import Interval
    from evaluator.uncertainty import NamedIntervals, Uncertainty

_COLUMNS = ("class", "boxes", "AP", "BEVCD", "YawSim", "PRSim", "SizeSim", "DS", "c_w")


def score_table(scores: Scores, uncertainty: "Uncertainty | None" = None) -> str:
    """Return one row for each class, the means below, and the signature as the last line.

    With intervals each row is followed by one with theirs.
    """
    rows: list[tuple[str, ...]] = []
    for item in scores.classes:
        values = (percent(getattr(item, name)) for name in METRICS)
        rows.append((item.label, str(item.ground_truth_count), *values, number(item.working_point)))
        rows += _interval_rows(None if uncertainty is None else uncertainty.classes[item.label])
    boxes = sum(item.ground_truth_count for item in scores.classes)
    rows.append(("mean", str(boxes), *(percent(getattr(scores, name)) for name in MEANS), ""))
    of_means = _interval_rows(None if uncertainty is None else uncertainty.means)
    head, *lines = aligned([_COLUMNS, *rows, *of_means])
    rule = "-" * len(head)
    end = len(rows) - 1
    table = [head, rule, *lines[:end], rule, *lines[end:]]
    note = zeroed_note(scores.zeroed_labels)
    end_lines = [*([note, ""] if note else []), *_last_lines(scores, uncertainty)]
    return "\n".join([*(line.rstrip() for line in table), "", *end_lines])


def zeroed_note(labels: Sequence[str]) -> str:
    """Say why classes that are found have a detection score of 0; "" without any."""
    why = "true positives in fewer than two depth bins, for which the reference makes all four similarities 0"
    return f"{', '.join(labels)}: {why}." if labels else ""


def _interval_rows(intervals: "NamedIntervals | None") -> list[tuple[str, ...]]:
    return [] if intervals is None else [("", "", *_bounds(intervals.values()), "")]


def _bounds(intervals: "Iterable[Interval | None]") -> list[str]:
    return [UNDEFINED if part is None else _range(part) for part in intervals]


def _range(interval: "Interval") -> str:
    doubt = "" if interval.is_proven else "?"
    return f"{percent(interval.lower, 1)}-{percent(interval.upper, 1)}{doubt}"


def _last_lines(scores: Scores, uncertainty: "Uncertainty | None") -> list[str]:
    line = f"mDS {percent(scores.mds)}  {scores.signature}"
    if uncertainty is None:
        return [line]
    level, units = f"{100 * uncertainty.level:g} %", UNITS[uncertainty.unit]
    drawn = f"{uncertainty.resamples} resamples of the {units}"
    few, none = f"too few {units} or boxes", ""
    if not can_be_resampled(scores.signature.protocol).all():
        none = f", and all but AP by the protocol {scores.signature.protocol.name}"
    intervals = [*uncertainty.means.values(), *(one for of in uncertainty.classes.values() for one in of.values())]
    unproven = any(interval and not interval.is_proven for interval in intervals)
    mark = f"?: unproven, {few}; n/a: undefined{none}" if unproven else f"n/a: {few}{none}"
    return [
        f"Second lines: {level} confidence intervals, {uncertainty.method}, {drawn}; {mark}.",
        "",
        line,
    ]
