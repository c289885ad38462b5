"""Assign predictions to ground-truth boxes: greedily by prediction or by box, or with the greatest total weight.

All take candidate pairs as parallel arrays and know nothing about boxes. Prediction rows are in descending score
order, so a smaller row means a higher score.
"""

import numpy as np

from evaluator.candidates import RowArray
from evaluator.comparison.boxes import BoolArray
from evaluator.predictions import Float64Array


def match_in_score_order(
    prediction: RowArray, ground_truth: RowArray, cost: Float64Array, *, ground_truth_count: int
) -> BoolArray:
    """Let each prediction, highest score first, take the cheapest ground-truth box still free.

    Done by deferred acceptance: every prediction without a box asks the best box it has not asked yet, a box keeps the
    highest score that asked. Because all boxes prefer the same order this ends exactly where the sequential
    rule ends, in a few vectorised rounds instead of one step a prediction.

    Args:
        prediction: (P,) prediction row of each candidate pair.
        ground_truth: (P,) ground-truth row of each candidate pair, below `ground_truth_count`.
        cost: (P,) lower is better; ties go to the earlier ground-truth row.
        ground_truth_count: Number of ground-truth boxes.

    Returns:
        (P,) True for the pairs that are matched; no prediction and no box is in two of them.
    """
    order = np.lexsort((ground_truth, cost, prediction))
    asker, asked = prediction[order], ground_truth[order]
    last = np.append(asker[1:] != asker[:-1], values=True)[: len(asker)]
    holder = np.full(ground_truth_count, -1)  # which candidate pair holds each box
    asking = np.flatnonzero(np.append(True, asker[1:] != asker[:-1])[: len(asker)])
    while len(asking):
        boxes = asked[asking]
        best = np.full(ground_truth_count, len(asker))
        np.minimum.at(best, boxes, asking)  # pairs are ordered by score: the smallest index asks best
        held = np.where(holder < 0, len(asker), holder)
        winner = np.minimum(best, held)
        touched = np.unique(boxes)
        losers = np.concatenate([asking[asking != winner[boxes]], held[touched][held[touched] > winner[touched]]])
        holder[touched] = winner[touched]
        losers = losers[losers < len(asker)]
        asking = losers[~last[losers]] + 1
    matched = np.zeros(len(asker), dtype=bool)
    matched[order[holder[holder >= 0]]] = True
    return matched


def match_by_box(
    prediction: RowArray, ground_truth: RowArray, overlap: Float64Array, excused: BoolArray
) -> tuple[RowArray, RowArray]:
    """Let each ground-truth box, in order, take the best prediction still free, at every score at once.

    Predictions enter one by one, highest score first. Whoever enters asks its boxes in their order; a box with nobody,
    or with somebody worse, takes it, and the one it held goes on to ask its own later boxes. That ends exactly where
    the boxes' own choice among all predictions so far would end, because each box sees one more prediction than before.

    Args:
        prediction: (P,) prediction row of each candidate pair.
        ground_truth: (P,) ground-truth row of each candidate pair.
        overlap: (P,) greater is better; ties go to the higher score.
        excused: (N,) which predictions are no false positives when they are not matched.

    Returns:
        Two (N,) arrays, after each prediction's entry: how many predictions are matched, and how many are neither
        matched nor excused.
    """
    order = np.lexsort((ground_truth, prediction))
    boxes, overlaps, asker = ground_truth[order].tolist(), overlap[order].tolist(), prediction[order].tolist()
    last = [*map(int.__ne__, asker[1:], asker[:-1]), True]
    holder: dict[int, int] = {}  # the pair that holds each box
    change = np.stack([np.zeros(len(excused), dtype=np.int64), ~excused])
    for first in np.flatnonzero(np.append(True, np.diff(prediction[order]) > 0)[: len(order)]).tolist():
        free_again = _enter(first, boxes, overlaps, last, holder)
        change[0, asker[first]] = free_again is None
        change[1, asker[first]] = 0 if free_again is None else not excused[asker[free_again]]
    found, wrong = np.cumsum(change, axis=1)
    return found, wrong


def _enter(pair: int, boxes: list[int], overlaps: list[float], last: list[bool], holder: dict[int, int]) -> int | None:
    """Let a prediction ask from its first pair on; return a pair of the one left without a box, None if nobody is."""
    while True:
        held = holder.get(boxes[pair])
        if held is None or overlaps[pair] > overlaps[held]:
            holder[boxes[pair]] = pair
            if held is None:
                return None
            pair = held
        if last[pair]:
            return pair
        pair += 1


def heaviest_assignments(weight: Float64Array) -> RowArray:
    """Find the assignment of greatest total weight for the first row, the first two rows, and so on.

    Rows are added one by one. The best assignment of one row more differs from the last one by a single chain of
    exchanges that starts at the new row; the chain of greatest gain is found by relaxation (Bellman-Ford).

    Args:
        weight: (R, C) weight of giving column c to row r, positive; -inf where that is not allowed.

    Returns:
        (R, C) the row that holds each column after rows 0..r are in, -1 where nobody does.
    """
    rows, columns = weight.shape
    owner = np.full(columns, -1)
    owners = np.empty((rows, columns), dtype=np.int64)
    for row in range(rows):
        _add_row(weight, owner, row)
        owners[row] = owner
    return owners


def _add_row(weight: Float64Array, owner: RowArray, row: int) -> None:
    """Bring one more row into the best assignment, changing `owner` in place."""
    gain, source = weight[row].copy(), np.full(len(owner), -1)
    held = np.flatnonzero(owner >= 0)
    own = weight[owner[held], held]
    for _ in held:
        through = (gain[held] - own)[:, None] + weight[owner[held]]
        through[np.arange(len(held)), held] = -np.inf
        best = through.argmax(axis=0)
        better = through[best, np.arange(len(owner))] > gain + 1e-12  # rounding must not build a cycle
        if not better.any():
            break
        gain[better], source[better] = through[best, np.arange(len(owner))][better], held[best[better]]
    final = gain.copy()
    final[held] -= own  # the chain may also end by leaving the last owner without a column
    column = int(final.argmax())
    if final[column] <= 0:
        return
    while source[column] >= 0:
        owner[column], column = owner[source[column]], int(source[column])
    owner[column] = row


def components(prediction: RowArray, ground_truth: RowArray) -> RowArray:
    """Name the connected component of each candidate pair.

    Returns:
        (P,) the smallest prediction row of the component. Empty for no pairs.
    """
    _, left = np.unique(prediction, return_inverse=True)
    _, right = np.unique(ground_truth, return_inverse=True)
    name = prediction.copy()
    while True:
        before = name
        for side in (left, right):
            smallest = np.full(side.max(initial=-1) + 1, np.iinfo(np.int64).max)
            np.minimum.at(smallest, side, name)
            name = smallest[side]
        if np.array_equal(name, before):
            return name
