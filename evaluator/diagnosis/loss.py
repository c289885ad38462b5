"""The points missing from a detection score, split exactly among what it is made of.

DS = AP x S with S the mean of four similarities. Of the 1 - DS that is missing, AP gets (1 - AP)(1 + S) / 2 and each
similarity x gets (1 - x)(1 + AP) / 8: the Shapley value of the product, the mean of repairing AP first and repairing
S first. The five parts sum up to 1 - DS.
"""

import msgspec

from evaluator.results import ClassScore

PARTS = ("ap", "bevcd", "yaw_sim", "pr_sim", "size_sim")


class Parts(msgspec.Struct, frozen=True, kw_only=True):
    """One number for each thing a detection score is made of; their sum is the number that was split."""

    ap: float
    bevcd: float
    yaw_sim: float
    pr_sim: float
    size_sim: float

    def total(self) -> float:
        """Return the sum of the parts."""
        return self.ap + self.bevcd + self.yaw_sim + self.pr_sim + self.size_sim


def split_change(before: tuple[float, ...], after: tuple[float, ...], weight: float = 1.0) -> Parts:
    """Split the change of a detection score among its five factors (Shapley value of AP x S; S is a sum already).

    Args:
        before: ap, bevcd, yaw_sim, pr_sim, size_sim.
        after: The same five.
        weight: Multiplies every part.

    Returns:
        Parts that sum up to weight x (DS after - DS before), up to rounding.
    """
    mean_ap = (before[0] + after[0]) / 2
    mean_similarity = (sum(before[1:]) + sum(after[1:])) / 8
    similarities = [weight * mean_ap * (new - old) / 4 for old, new in zip(before[1:], after[1:], strict=True)]
    return Parts(
        ap=weight * mean_similarity * (after[0] - before[0]), **dict(zip(PARTS[1:], similarities, strict=True))
    )


def factors(score: ClassScore) -> tuple[float, ...] | None:
    """Return ap, bevcd, yaw_sim, pr_sim, size_sim of a class, None if it is undefined."""
    values = (score.ap, score.bevcd, score.yaw_sim, score.pr_sim, score.size_sim)
    defined = tuple(value for value in values if value is not None)
    return defined if len(defined) == len(PARTS) else None


def loss(score: ClassScore) -> Parts | None:
    """Split what is missing from a class's detection score to 1; None for a class without ground truth."""
    reached = factors(score)
    return None if reached is None else split_change(reached, (1.0,) * len(PARTS))
