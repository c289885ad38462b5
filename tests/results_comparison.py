"""Comparing whole result documents, number by number."""

import math
from collections.abc import Iterator
from typing import Any


def differences(ours: Any, expected: Any, *, tolerance: float = 1e-9, path: str = "") -> Iterator[str]:
    """Yield every place where two JSON-like values differ: keys, lengths, types, or numbers beyond the tolerance."""
    if isinstance(expected, dict) and isinstance(ours, dict):
        if list(ours) != list(expected):
            yield f"{path}: keys {list(ours)} instead of {list(expected)}"
        for key in expected.keys() & ours.keys():
            yield from differences(ours[key], expected[key], tolerance=tolerance, path=f"{path}/{key}")
    elif isinstance(expected, list) and isinstance(ours, list):
        if len(ours) != len(expected):
            yield f"{path}: {len(ours)} items instead of {len(expected)}"
        for index, (mine, theirs) in enumerate(zip(ours, expected, strict=False)):
            yield from differences(mine, theirs, tolerance=tolerance, path=f"{path}/{index}")
    elif isinstance(expected, (int, float)) and isinstance(ours, (int, float)):
        if not _equal(ours, expected, tolerance):
            yield f"{path}: {ours!r} instead of {expected!r}"
    elif ours != expected:
        yield f"{path}: {ours!r} instead of {expected!r}"


def _equal(ours: float, expected: float, tolerance: float) -> bool:
    if math.isnan(expected) or math.isnan(ours):
        return math.isnan(expected) and math.isnan(ours)
    return abs(ours - expected) <= tolerance
