"""Means over the classes, ranges or thresholds for which a number is defined."""

from collections.abc import Iterable


def defined_mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of the defined values, None when there is none."""
    defined = [value for value in values if value is not None]
    return sum(defined) / len(defined) if defined else None
