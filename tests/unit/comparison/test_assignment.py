"""Greedy assignment in score order and assignment of greatest weight, against slow and obvious versions."""

from itertools import permutations

import numpy as np
import pytest

from evaluator.comparison.assignment import components, heaviest_assignments, match_in_score_order


def sequential(prediction: np.ndarray, ground_truth: np.ndarray, cost: np.ndarray) -> set[tuple[int, int]]:
    """Match one prediction after the other, as the benchmarks write it down."""
    taken: dict[int, int] = {}
    for row in np.unique(prediction):
        free = [
            (c, g)
            for p, g, c in zip(prediction, ground_truth, cost, strict=True)
            if p == row and g not in taken.values()
        ]
        if free:
            taken[int(row)] = int(min(free)[1])
    return set(taken.items())


@pytest.mark.parametrize("seed", range(25))
def test_score_order_equals_the_sequential_rule(seed: int) -> None:
    """Deferred acceptance ends where one prediction after the other would end, ties in cost included."""
    rng = np.random.default_rng(seed)
    pairs = [(p, g) for p in range(15) for g in range(8) if rng.random() < 0.4]
    prediction, ground_truth = (np.array(column) for column in zip(*rng.permutation(pairs), strict=True))
    cost = rng.integers(0, 4, len(prediction)).astype(float)
    matched = match_in_score_order(prediction, ground_truth, cost, ground_truth_count=8)
    found = set(zip(prediction[matched].tolist(), ground_truth[matched].tolist(), strict=True))
    assert found == sequential(prediction, ground_truth, cost)


def test_score_order_prefers_the_higher_score_over_the_better_fit() -> None:
    """The first prediction takes the box although the second is nearer."""
    matched = match_in_score_order(np.array([0, 1]), np.array([0, 0]), np.array([0.9, 0.1]), ground_truth_count=1)
    assert matched.tolist() == [True, False]


def test_no_pairs_match_nothing() -> None:
    """Without candidate pairs nothing is matched."""
    none = np.empty(0, dtype=np.int64)
    assert len(match_in_score_order(none, none, np.empty(0), ground_truth_count=3)) == 0
    assert len(components(none, none)) == 0


def best_total(weight: np.ndarray) -> float:
    """Try every assignment of rows to columns or to nothing."""
    rows, columns = weight.shape
    padded = np.hstack([np.where(np.isfinite(weight), weight, 0.0), np.zeros((rows, rows))])
    return max(
        sum(float(padded[row, column]) for row, column in enumerate(choice))
        for choice in permutations(range(columns + rows), rows)
    )


@pytest.mark.parametrize("seed", range(20))
def test_heaviest_assignment_is_the_best_for_every_number_of_rows(seed: int) -> None:
    """After each row the total weight is the greatest of all possible assignments of the rows so far."""
    rng = np.random.default_rng(seed)
    weight = np.where(rng.random((4, 3)) < 0.7, rng.uniform(0.1, 1, (4, 3)), -np.inf)
    owners = heaviest_assignments(weight)
    for rows in range(1, 5):
        owner = owners[rows - 1]
        held = owner >= 0
        assert owner.max(initial=-1) < rows
        assert len(set(owner[held].tolist())) == held.sum()
        assert weight[owner[held], np.flatnonzero(held)].sum() == pytest.approx(best_total(weight[:rows]), abs=1e-12)


def test_heaviest_assignment_moves_an_earlier_row_when_that_pays() -> None:
    """The second row takes the first row's column, and the first row moves to its second choice."""
    # 0.8 + 0.6 = 1.4 beats 0.9 + nothing
    weight = np.array([[0.9, 0.6], [0.8, -np.inf]])
    assert heaviest_assignments(weight).tolist() == [[0, -1], [1, 0]]


def test_components_carry_the_smallest_prediction() -> None:
    """Pairs that hang together through any chain have one name."""
    # 0-a-1-b-4 is one chain, 2-c another
    prediction, ground_truth = np.array([0, 1, 1, 4, 2]), np.array([0, 0, 1, 1, 2])
    assert components(prediction, ground_truth).tolist() == [0, 0, 0, 0, 2]
