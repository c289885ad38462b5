"""What is killed where, and the account of what was."""

import itertools
import random
from collections import Counter
from collections.abc import Iterator, Sequence

from tests.faults.points import POINTS

Pair = tuple[str, str]
"""A point and a target."""


def kills(chance: random.Random, targets: Sequence[str]) -> Iterator[Pair]:
    """Pair points with targets for ever, each point and each target about as often as any other at any time.

    Both go round in a shuffled order. Nine points and seven or eight targets have no common divisor, so after as many
    steps as there are pairs every pair was there once.
    """
    points = itertools.cycle(chance.sample(POINTS, len(POINTS)))
    return zip(points, itertools.cycle(chance.sample(targets, len(targets))), strict=False)


def pairs(targets: Sequence[str]) -> set[Pair]:
    """Give every pair."""
    return set(itertools.product(POINTS, targets))


def table(done: Counter[Pair], targets: Sequence[str]) -> Iterator[str]:
    """Write down how often each target was killed at each point."""
    width = max(map(len, targets))
    yield " ".join([" " * width, *POINTS])
    for target in targets:
        counts = (f"{done[point, target]:>{len(point)}}" for point in POINTS)
        yield " ".join([f"{target:<{width}}", *counts])
