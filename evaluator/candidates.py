"""Pairs of rows that belong to the same group (image, or image and class), produced in blocks.

The cost is the number of pairs. It grows linearly with the predictions, because the ground truth is fixed.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

RowArray = NDArray[np.int64]
GroupArray = NDArray[np.int64] | NDArray[np.int32]

PAIRS_IN_BLOCK = 1 << 16
"""Pairs produced at a time, so that memory stays small and arrays stay in the processor's cache."""


def pairs_within_groups(left_group: GroupArray, right_group: GroupArray) -> Iterator[tuple[RowArray, RowArray]]:
    """Yield all pairs of rows with equal group.

    Args:
        left_group: (L,) group of each left row: small whole numbers; a negative one has no partner.
        right_group: (R,) group of each right row, likewise.

    Yields:
        Left rows and right rows of the pairs, in blocks. Over all blocks, pairs come ordered by left row, then
        right row. A block holds about `PAIRS_IN_BLOCK` pairs, more when one left row alone has more.
    """
    groups = max(int(left_group.max(initial=-1)), int(right_group.max(initial=-1))) + 1
    size = np.bincount(right_group[right_group >= 0], minlength=groups + 1)
    size[-1] = 0  # where the index -1 leads
    begin = np.cumsum(size) - size
    by_group = _stable_order(right_group, groups)[np.count_nonzero(right_group < 0) :]
    left_group = np.maximum(left_group, -1)
    first, count = begin[left_group], size[left_group]
    for rows in _blocks(count):
        left = np.repeat(np.arange(rows.start, rows.stop), count[rows])
        yield left, by_group[_concatenated_ranges(first[rows], count[rows])]


def _stable_order(group: GroupArray, groups: int) -> RowArray:
    """Sort rows by group, negative ones first; numpy sorts 16-bit numbers by counting, ten times as fast."""
    few = groups <= np.iinfo(np.int16).max
    return np.argsort(np.maximum(group, -1).astype(np.int16 if few else np.int64), kind="stable")


def _blocks(count: RowArray) -> Iterator[slice]:
    """Split rows so that each block's counts sum up to about `PAIRS_IN_BLOCK`; skip what has no pairs."""
    total = np.cumsum(count)
    start = 0
    while start < len(count):
        done = total[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(total, done + PAIRS_IN_BLOCK, side="right")))
        if total[stop - 1] > done:
            yield slice(start, stop)
        start = stop


def _concatenated_ranges(first: RowArray, count: RowArray) -> RowArray:
    """Return first[0] ... first[0] + count[0] - 1, first[1] ... in one array."""
    before = np.cumsum(count) - count
    return np.asarray(np.arange(count.sum()) + np.repeat(first - before, count))
