"""Mistakes in scores and labels."""

from collections.abc import Iterable
from collections.abc import Set as AbstractSet

from evaluator.codes import Code
from evaluator.doctor.evidence import FEWEST_BOXES
from evaluator.findings import Findings
from evaluator.predictions import Float64Array
from evaluator.thresholds import share_below_lowest_threshold

_PERCENT = 100.0


def check_scores(score: Float64Array, findings: Findings) -> None:
    """Look at all scores together.

    Args:
        score: (N,) of every box that could be read, in whatever range.
        findings: receives the warnings.
    """
    if not len(score) and not findings.error_count:  # with errors boxes may have been lost to them
        findings.add(Code.NO_BOXES)
    _check_percent(score, findings)
    if len(score) < FEWEST_BOXES:
        return
    if score.min() == score.max():
        findings.add(Code.SCORES_ALL_EQUAL, found=f"{len(score)} times {score[0]:g}")
        findings.trust(Code.SCORES_ALL_EQUAL, 0.99)
    below = share_below_lowest_threshold(score)
    if below is not None and below > 0.99:  # noqa: PLR2004 -- detectors give many low scores, but not only such
        findings.add(Code.SCORES_BELOW_THRESHOLDS, found=f"{below:.0%} of {len(score)} scores are below 0.02")
        findings.trust(Code.SCORES_BELOW_THRESHOLDS, 0.99)


def _check_percent(score: Float64Array, findings: Findings) -> None:
    """Most scores lie above 1, none above 100."""
    above = (score > 1.0) & (score <= _PERCENT)
    if len(score) and above.mean() > 0.5 and score.max() <= _PERCENT:  # noqa: PLR2004 -- most
        findings.add(Code.SCORES_IN_PERCENT, found=f"{above.mean():.0%} of the scores lie between 1 and 100")
        findings.trust(Code.SCORES_IN_PERCENT, round(min(0.99, 0.5 + float(above.mean()) / 2), 2))


def check_labels(unknown: Iterable[str], known: AbstractSet[str], findings: Findings) -> None:
    """Look at the labels that were refused.

    Args:
        unknown: as they were found, numbers as text.
        known: the data set's classes.
        findings: receives the warnings.
    """
    labels = sorted(set(unknown))
    respelt = {label: _normal_spelling(label) for label in labels}
    close = [f"{label} for {respelt[label]}" for label in labels if respelt[label] in known]
    if close:
        findings.add(Code.LABELS_CAPITALISED, found=", ".join(close[:10]))
        findings.trust(Code.LABELS_CAPITALISED, 0.99)
    numbers = [label for label in labels if label.strip().lstrip("-").isdecimal()]
    if numbers:
        findings.add(Code.LABELS_NUMERIC, found=", ".join(numbers[:10]))
        findings.trust(Code.LABELS_NUMERIC, 0.99)


def _normal_spelling(label: str) -> str:
    """Write a label as the data set would."""
    return label.strip().lower().removesuffix("s") if label.strip().lower() != "bus" else "bus"
