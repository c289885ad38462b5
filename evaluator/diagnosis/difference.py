"""The difference of two submissions' mean detection scores, split exactly: class x {AP, BEVCD, YawSim, PRSim, SizeSim}.

The mDS is the mean of AP x S over K classes, S being the mean of four similarities. A class contributes
(AP2 S2 - AP1 S1) / K, of which AP gets (AP2 - AP1)(S1 + S2) / 2 / K and each similarity (x2 - x1)(AP1 + AP2) / 8 / K.
That is the Shapley value: the mean of changing AP first and changing S first. All parts of all classes sum up to the
difference of the two mDS.
"""

import msgspec

from evaluator.diagnosis.loss import PARTS, Parts, factors, split_change
from evaluator.errors import UsageError
from evaluator.protocol import Signature, require_comparable
from evaluator.results import ClassScore, Scores


class ClassDifference(msgspec.Struct, frozen=True, kw_only=True):
    """What one class contributes; None without ground truth."""

    label: str
    detection_score: tuple[float, float] | None
    """Of the first and the second submission."""
    parts: Parts | None
    """In units of the mDS: already divided by the number of classes."""
    total: float | None
    """Sum of the parts."""


class Difference(msgspec.Struct, frozen=True, kw_only=True):
    """The second submission minus the first; positive: the second is better."""

    signatures: tuple[Signature, Signature]
    """Of the first and the second submission; they differ in the digest of the predictions only."""
    mds: tuple[float | None, float | None]
    """Of the first and the second submission."""
    total: float | None
    """Second minus first mDS, None when no class has ground truth."""
    parts: Parts | None
    """Summed over the classes; their sum is `total`."""
    zeroed_labels: tuple[tuple[str, ...], tuple[str, ...]]
    """`Scores.zeroed_labels` of the first and the second submission."""
    classes: tuple[ClassDifference, ...]


def explain_difference(first: Scores, second: Scores) -> Difference:
    """Split the difference of two submissions that were scored the same way.

    Raises:
        UsageError: They were scored by other protocols or against other ground truth.
    """
    _check_comparable(first, second)
    counted = sum(1 for score in first.classes if factors(score) is not None)
    classes = tuple(_of_class(*pair, counted) for pair in zip(first.classes, second.classes, strict=True))
    total = None if first.mds is None or second.mds is None else second.mds - first.mds
    return Difference(
        signatures=(first.signature, second.signature),
        mds=(first.mds, second.mds),
        total=total,
        parts=_sum(classes),
        zeroed_labels=(first.zeroed_labels, second.zeroed_labels),
        classes=classes,
    )


def _check_comparable(first: Scores, second: Scores) -> None:
    """Refuse scores that depend on more than the predictions."""
    require_comparable(first.signature, second.signature)
    one, other = ([score.ground_truth_count for score in scores.classes] for scores in (first, second))
    if one != other:
        raise UsageError("Score both submissions against the same ground truth; their differences mean nothing else.")


def _of_class(first: ClassScore, second: ClassScore, counted: int) -> ClassDifference:
    """Split the difference of one class."""
    before, after = factors(first), factors(second)
    if before is None or after is None or first.detection_score is None or second.detection_score is None:
        return ClassDifference(label=first.label, detection_score=None, parts=None, total=None)
    parts = split_change(before, after, 1 / counted)
    return ClassDifference(
        label=first.label,
        detection_score=(first.detection_score, second.detection_score),
        parts=parts,
        total=parts.total(),
    )


def _sum(classes: tuple[ClassDifference, ...]) -> Parts | None:
    """Add up the parts of the classes; None without a class."""
    defined = [part.parts for part in classes if part.parts is not None]
    if not defined:
        return None
    return Parts(**{name: sum(getattr(parts, name) for parts in defined) for name in PARTS})
