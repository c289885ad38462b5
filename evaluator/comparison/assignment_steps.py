"""The assignment of greatest total weight while predictions come in one by one, highest score first.

Waymo assigns anew at each of 101 score cutoffs. One pass over the predictions gives the assignments of all cutoffs.
"""

import numpy as np

from evaluator.candidates import RowArray
from evaluator.comparison.assignment import components, heaviest_assignments
from evaluator.comparison.boxes import BoolArray
from evaluator.comparison.weighted_pairs import WeightedPairs
from evaluator.predictions import Float64Array


def assignment_steps(pairs: WeightedPairs, excused: BoolArray) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Tell what each prediction changes when predictions enter the best assignment one by one, highest score first.

    Returns:
        Three (N,) arrays, one value for each prediction: change in the number of true positives, in the sum of their
        affinities, and in the number of true positives that lie in ignore regions. Sums from the start give
        the state after each prediction, so one pass serves all score cutoffs.
    """
    change = np.zeros((3, len(excused)))
    name = components(pairs.prediction, pairs.ground_truth)
    order = np.lexsort((pairs.ground_truth, pairs.prediction, name))
    pairs, name = pairs.take(order), name[order]
    starts = np.flatnonzero(np.append(True, name[1:] != name[:-1])[: len(name)])
    sizes = np.diff(np.append(starts, len(name)))
    boxes = pairs.ground_truth
    one_box = np.minimum.reduceat(boxes, starts) == np.maximum.reduceat(boxes, starts) if len(starts) else sizes > 0
    simple = np.repeat(one_box, sizes)
    _add_single_boxes(pairs.take(simple), name[simple], excused, change)
    for start, size in zip(starts[~one_box], sizes[~one_box], strict=True):
        _add_component(pairs.take(np.arange(start, start + size)), excused, change)
    return change[0], change[1], change[2]


def _add_single_boxes(pairs: WeightedPairs, name: RowArray, excused: BoolArray, change: Float64Array) -> None:
    """Write the steps of all components with one ground-truth box: the heaviest prediction so far holds it.

    Args:
        pairs: Ordered by component, then by prediction.
        name: (P,) component of each pair.
        excused: (N,) predictions in ignore regions.
        change: (3, N) steps, written in place.
    """
    first = np.append(True, name[1:] != name[:-1])[: len(name)]
    _, rank = np.unique(pairs.weight, return_inverse=True)
    value = np.cumsum(first) * (len(rank) + 1) + rank
    heaviest = np.maximum.accumulate(value)
    takes = np.append(True, heaviest[1:] > heaviest[:-1])[: len(value)]
    holder = np.maximum.accumulate(np.where(takes, np.arange(len(value)), 0))
    state = np.stack([np.ones(len(holder)), pairs.affinity[holder], excused[pairs.prediction[holder]]])
    before = np.where(first, 0.0, np.roll(state, 1, axis=1))
    change[:, pairs.prediction] = state - before


def _add_component(pairs: WeightedPairs, excused: BoolArray, change: Float64Array) -> None:
    """Write the steps of one connected component with several ground-truth boxes into `change`."""
    rows, row = np.unique(pairs.prediction, return_inverse=True)
    columns, column = np.unique(pairs.ground_truth, return_inverse=True)
    weight = np.full((len(rows), len(columns)), -np.inf)
    affinity = np.zeros_like(weight)
    weight[row, column], affinity[row, column] = pairs.weight, pairs.affinity
    owners = heaviest_assignments(weight)
    held = owners >= 0
    after = np.stack(
        [
            held.sum(axis=1),
            (affinity[owners, np.arange(len(columns))] * held).sum(axis=1),
            (excused[rows][owners] & held).sum(axis=1),
        ]
    )
    change[:, rows] = np.diff(after, axis=1, prepend=0.0)
