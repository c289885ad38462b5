"""How often a rank interval holds the true rank, by simulation: at least 95 times in 100.

    python bench/rank_coverage.py [--data-sets=300] [--images=1525]

A synthetic benchmark of 4000 images plays the population; the ranks of the mDS on it are the truth. Of the ten methods some
are draws of one and the same, so that they are almost equal. Each simulated data set draws images from it; ranks, intervals and what can be told
apart are computed as on a leaderboard. The standard error of 95 % in N data sets is 22 / sqrt(N) percent points.
"""

import argparse
import sys
from itertools import combinations
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bench._population import POPULATION, populations, taken  # noqa: E402 - the path is set above
from evaluator.protocol import CITYSCAPES3D  # noqa: E402 - likewise
from evaluator.replicates import MEANS, replicate  # noqa: E402 - likewise
from evaluator.standings import Standings  # noqa: E402 - likewise
from evaluator.uncertainty import mds_replicates  # noqa: E402 - likewise

METHODS = [(0, 8), (0, 9), (0, 10), (0, 11), (1, 8), (1, 9), (1, 10), (2, 8), (2, 9), (2, 10)]
"""Which of `QUALITIES`, and the seed."""


def main() -> None:
    """Simulate and print a line for each method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data-sets", type=int, default=300)
    parser.add_argument("--images", type=int, default=1525)
    args = parser.parse_args()
    population = populations(METHODS, CITYSCAPES3D)
    everything = np.ones((1, POPULATION), dtype=np.float32)
    mds = np.array([replicate(method, everything).means[0, MEANS.index("mds")] for method in population])
    true_rank = 1 + (mds[:, None] < mds).sum(axis=1)
    rng = np.random.default_rng(5)
    widths, holds, wrongly_apart, apart = [], [], 0, 0
    for _ in range(args.data_sets):
        drawn = rng.integers(0, POPULATION, args.images)
        own = [mds_replicates(taken(method, drawn, np.ones_like(drawn))) for method in population]
        standings = Standings.of(own)
        best, worst = np.array(standings.rank_intervals()).T
        holds.append((best <= true_rank) & (true_rank <= worst))
        widths.append(worst - best + 1)
        for one, other in combinations(range(len(METHODS)), 2):
            if standings.apart[one, other]:
                apart += 1
                wrongly_apart += (np.median(own[one]) > np.median(own[other])) != (mds[one] > mds[other])
    print(f"{args.data_sets} data sets of {args.images} images; 95 % rank intervals")
    print(f"{'true rank':>9} {'mDS':>7} {'held, percent':>14} {'ranks in it':>12}")
    for place in np.argsort(true_rank).tolist():
        share, width = 100 * np.mean(holds, axis=0)[place], np.mean(widths, axis=0)[place]
        print(f"{true_rank[place]:9} {100 * mds[place]:7.2f} {share:14.1f} {width:12.2f}")
    print(f"all: {100 * np.mean(holds):.1f} percent; of {apart} pairs told apart {wrongly_apart} the wrong way round")


if __name__ == "__main__":
    main()
