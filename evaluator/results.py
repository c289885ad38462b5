"""The scores of one submission under one protocol, as plain frozen values.

All numbers are in full precision. `None` means undefined (nothing to measure on); it is never replaced by 0.
Every score lies in [0, 1] and greater is better.
"""

import msgspec

from evaluator.protocol import CITYSCAPES3D, FEWEST_BINS, Signature


class DepthBin(msgspec.Struct, frozen=True, kw_only=True):
    """One class in the depth range [lower_m, upper_m), measured from the vehicle's rear axle on the ground plane."""

    lower_m: int
    upper_m: int
    ground_truth_count: int
    ap: float | None
    """Depth-dependent average precision; None without ground truth in the bin."""
    recall: tuple[float, ...]
    """One value per score threshold, lowest first; empty without ground truth in the bin."""
    precision: tuple[float, ...]
    true_positive_count: int
    """True positives at the working point; with none the four similarities are None."""
    bevcd: float | None
    yaw_sim: float | None
    pr_sim: float | None
    size_sim: float | None


class ClassScore(msgspec.Struct, frozen=True, kw_only=True):
    """One class. Everything is None for a class without ground truth, which does not enter any mean."""

    label: str
    ground_truth_count: int
    ap: float | None
    bevcd: float | None
    yaw_sim: float | None
    pr_sim: float | None
    size_sim: float | None
    detection_score: float | None
    """ap x (bevcd + yaw_sim + pr_sim + size_sim) / 4 (paper, section Detection Score)."""
    working_point: float | None
    recall: tuple[float, ...]
    """One value per score threshold, lowest first."""
    precision: tuple[float, ...]
    depth_bins: tuple[DepthBin, ...]
    """Every bin from 0 to the maximum depth, empty ones too."""

    @property
    def filled_bins(self) -> int:
        """Count the depth bins with a true positive."""
        return sum(one.true_positive_count > 0 for one in self.depth_bins)


class Scores(msgspec.Struct, frozen=True, kw_only=True):
    """The whole result. Means are over the classes with ground truth, None when there is no such class."""

    signature: Signature
    mds: float | None
    """Mean detection score: the number that ranks."""
    map: float | None
    mbevcd: float | None
    myaw_sim: float | None
    mpr_sim: float | None
    msize_sim: float | None
    thresholds: tuple[float, ...]
    """The score thresholds behind every recall and precision list."""
    classes: tuple[ClassScore, ...]
    """In the protocol's order of labels."""

    @property
    def zeroed_labels(self) -> tuple[str, ...]:
        """Name the classes that are found and yet have a detection score of 0, by a rule.

        With true positives in fewer than two depth bins `cityscapes3d`, like the reference, makes all similarities 0.
        """
        if self.signature.protocol.name != CITYSCAPES3D.name:
            return ()
        return tuple(one.label for one in self.classes if one.ap and one.filled_bins < FEWEST_BINS)
