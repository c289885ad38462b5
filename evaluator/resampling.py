"""Resamples of the images of a benchmark: how often each image counts.

The bootstrap draws as many units as there are, with replacement. A unit is an image, or, because images of one drive
resemble each other, all images of one sequence or city. Equal arguments give equal resamples, so two submissions,
evaluated at different times, can be compared on the same ones.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from evaluator.errors import UsageError
from evaluator.predictions import IndexArray

Unit = Literal["image", "sequence", "city"]
"""What is drawn as a whole: names are `<city>_<sequence>_<frame>`."""

UNITS: dict[Unit, str] = {"image": "images", "sequence": "sequences", "city": "cities"}
"""Each unit, and several of it."""

FEWEST_TO_DRAW_FROM = 2
"""One unit drawn as often as there are units is the same data set each time: nothing would vary."""

WeightArray = NDArray[np.float32]
"""(R, I) how often each resample holds each image: whole numbers."""
FloatingArray = NDArray[np.floating[Any]]


def bootstrap_weights(images: tuple[str, ...], *, resamples: int, seed: int, unit: Unit = "image") -> WeightArray:
    """Draw resamples.

    Args:
        images: I image names.
        resamples: How many to draw, R.
        seed: Decides the draw.
        unit: What is drawn as a whole.

    Returns:
        (R, I) weights; those of one image lie together in memory, because they are mostly used so.

    Raises:
        UsageError: There is nothing to draw from, or nothing to draw.
    """
    if resamples < 1:
        raise UsageError(f"{resamples} resamples say nothing; draw at least 1, better 1000.")
    if seed < 0:
        raise UsageError("The seed must be a whole number of 0 or more.")
    member = unit_index(images, unit)
    units = int(member.max(initial=-1)) + 1
    if units < FEWEST_TO_DRAW_FROM:
        message = f"Resampling needs at least {FEWEST_TO_DRAW_FROM} of what is drawn as a whole ({unit}),"
        raise UsageError(f"{message} and there is {units}. Draw smaller units, or evaluate more images.")
    drawn = np.random.default_rng(seed).integers(0, units, size=(resamples, units), dtype=np.int32)
    drawn += (np.arange(resamples, dtype=np.int32) * units)[:, None]
    times = np.bincount(drawn.ravel(), minlength=resamples * units).reshape(resamples, units)
    return np.asarray(times.T.astype(np.float32)[member].T)


def once(images: tuple[str, ...]) -> WeightArray:
    """Return (1, I) weights that count every image once: the data set as it is."""
    return np.ones((1, len(images)), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class LeaveOneOut:
    """The jackknife: U data sets, each without one unit. Kept as it is, because subtracting is cheaper than weighting."""

    member: IndexArray
    """(I,) the unit of each image."""

    @property
    def units(self) -> int:
        """Number of units, U."""
        return int(self.member.max(initial=-1)) + 1


def leave_one_out(images: tuple[str, ...], *, unit: Unit = "image") -> LeaveOneOut:
    """Leave out one unit at a time."""
    return LeaveOneOut(unit_index(images, unit))


Weighting = WeightArray | LeaveOneOut


def weighting_count(weighting: Weighting) -> int:
    """Return the number of weightings, R."""
    return weighting.units if isinstance(weighting, LeaveOneOut) else len(weighting)


def totals(
    weighting: Weighting, images: NDArray[np.intp], values: FloatingArray
) -> tuple[FloatingArray, NDArray[np.intp]]:
    """Sum up values of some of the images under each weighting, once where nothing of them is left out.

    Args:
        weighting: R weightings of I images.
        images: (J,) which images have values; the others count as 0.
        values: (J, K).

    Returns:
        (S, K) sums, in the precision of the values, and (R,) which of them is that of each weighting.
    """
    rows = np.arange(weighting_count(weighting))
    if not isinstance(weighting, LeaveOneOut):
        return totals_of(weighting, rows, images, values), rows
    member = weighting.member[images]
    order = np.argsort(member, kind="stable")
    units, start = np.unique(member[order], return_index=True)
    whole = values.sum(axis=0)
    of_row = np.zeros_like(rows)
    of_row[units] = np.arange(1, len(units) + 1)
    return np.concatenate([whole[None], whole - np.add.reduceat(values[order], start, axis=0)]), of_row


def totals_of(
    weighting: Weighting, rows: NDArray[np.intp], images: NDArray[np.intp], values: FloatingArray
) -> FloatingArray:
    """Do the same for some of the weightings.

    Args:
        weighting: R weightings of I images.
        rows: (S,) which weightings.
        images: (J,) which images have values.
        values: (J, K).

    Returns:
        (S, K).
    """
    if isinstance(weighting, LeaveOneOut):
        distinct, of_row = totals(weighting, images, values)
        return distinct[of_row[rows]]
    if len(rows) == len(weighting):
        return np.asarray(weighting.T.take(images, axis=0).T.astype(values.dtype, copy=False) @ values)
    chosen = weighting.T.take(rows, axis=1).take(images, axis=0).T
    # The layout decides on the last bit of a product, and stored replicates are compared bit by bit.
    return np.asarray(chosen.astype(values.dtype, order="C") @ values)


def weights_of_images(weighting: Weighting, rows: NDArray[np.intp]) -> WeightArray:
    """Return (I, S) how often some of the weightings count each image, S numbers together in memory."""
    if isinstance(weighting, LeaveOneOut):
        return np.asarray(weighting.member[:, None] != rows, dtype=np.float32)
    return weighting.T.take(rows, axis=1)


def unit_index(images: tuple[str, ...], unit: Unit) -> IndexArray:
    """Return (I,) the number of the unit each image belongs to, counted in the order of their names.

    Raises:
        UsageError: There is no such unit.
    """
    if unit not in UNITS:
        raise UsageError(f"{unit!r} cannot be drawn; choose one of {', '.join(UNITS)}.")
    dropped_parts = {"image": 0, "sequence": 1, "city": 2}[unit]
    names = [image.rsplit("_", dropped_parts)[0] if dropped_parts else image for image in images]
    number = {name: index for index, name in enumerate(sorted(set(names)))}
    return np.array([number[name] for name in names], dtype=np.int32)
