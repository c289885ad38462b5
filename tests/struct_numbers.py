"""Every value of a result by the name of its field, to hold results to tables in which each metric is classified."""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import msgspec
import pytest

Numbers = Mapping[str, list[Any]]


def numbers_by_field(result: msgspec.Struct) -> Numbers:
    """Return all values of a field under "Struct.field", in the order they come in."""
    found: dict[str, list[Any]] = defaultdict(list)
    for name, value in _leaves(result):
        found[name].append(value)
    return found


def _leaves(value: object, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, msgspec.Struct):
        for field in value.__struct_fields__:
            yield from _leaves(getattr(value, field), f"{type(value).__name__}.{field}")
    elif isinstance(value, tuple):
        for part in value:
            yield from _leaves(part, name)
    else:
        yield name, value


def changed_fields(before: Numbers, after: Numbers, names: Collection[str]) -> set[str]:
    """Return which of the named fields differ by more than the rounding of sums in another order."""
    return {name for name in names if before[name] != pytest.approx(after[name], abs=1e-12)}
