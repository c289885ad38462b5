"""Between which ranks the submissions of a leaderboard may stand, and which of them cannot be told apart.

Everything follows from the mDS of each submission on the same resamples of the images. A submission is added with one
pass over the others; nothing that is known of them is computed again.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from evaluator.confidence import LEVEL, most_contrary, require_level, tails
from evaluator.predictions import Float64Array


@dataclass(frozen=True, slots=True)
class Standings:
    """M submissions on R resamples."""

    mds: Float64Array
    """(M, R); minus infinity where undefined, which is worse than anything."""
    ranks: NDArray[np.int32]
    """(M, R) from 1; ties share the better rank."""
    apart: NDArray[np.bool_]
    """(M, M) whether two submissions differ with the confidence asked for."""
    level: float

    @classmethod
    def of(cls, submissions: Iterable[Float64Array], level: float = LEVEL) -> Self:
        """Compare submissions.

        Args:
            submissions: Of each (R,) its mDS on the same resamples (`mds_replicates`); NaN where undefined.
            level: Confidence level in (0, 1).

        Returns:
            The standings, in the order given.

        Raises:
            UsageError: The level is none.
        """
        require_level(level)
        rows = [np.asarray(row, dtype=np.float64) for row in submissions]
        resamples = len(rows[0]) if rows else 0
        nobody = np.zeros((0, resamples))
        standings = cls(nobody, nobody.astype(np.int32), np.zeros((0, 0), dtype=bool), level)
        for row in rows:
            standings = standings.adding(row)
        return standings

    def adding(self, mds: Float64Array) -> Self:
        """Return the standings with one more submission, (R,) on the same resamples, as the last one."""
        added = np.where(np.isnan(mds), -np.inf, mds)
        wins = added > self.mds
        own = 1 + (self.mds > added).sum(axis=0, dtype=np.int32)
        apart = np.pad(self.apart, (0, 1))
        apart[-1, :-1] = apart[:-1, -1] = self._differ(wins, self.mds > added)
        return type(self)(
            np.concatenate([self.mds, added[None]]), np.concatenate([self.ranks + wins, own[None]]), apart, self.level
        )

    def _differ(self, wins: NDArray[np.bool_], losses: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (M,) whether the p-value of the difference (`compare_replicates`) is at most 1 - level."""
        fewest = wins.shape[1] - most_contrary(wins.shape[1], self.level)
        return np.asarray((wins.sum(axis=1) >= fewest) | (losses.sum(axis=1) >= fewest))

    def rank_intervals(self) -> list[tuple[int, int]]:
        """Return the best and the worst rank of each submission, leaving out the tails of the distribution."""
        if not len(self.mds):
            return []
        bounds = np.quantile(self.ranks, tails(self.level), axis=1, method="closest_observation")
        return [(int(best), int(worst)) for best, worst in bounds.T]

    def groups(self, order: Iterable[int]) -> list[list[int]]:
        """Group neighbours in the ranking that cannot be told apart.

        Args:
            order: The submissions by rank, best first.

        Returns:
            Groups of at least two, best first. Within a group no submission differs from another; a submission may be
            in several groups or in none, and no group is part of another.
        """
        ranking = list(order)
        groups: list[list[int]] = []
        reach = 0
        for start in range(len(ranking)):
            stop = start + 1
            while stop < len(ranking) and not self.apart[ranking[stop], ranking[start:stop]].any():
                stop += 1
            if stop > max(reach, start + 1):
                groups.append(ranking[start:stop])
            reach = max(reach, stop)
        return groups
