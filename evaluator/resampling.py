"""Resamples of the images of a benchmark: how often each image counts.

The bootstrap draws as many units as there are, with replacement. A unit is an image, or, because images of one drive
resemble each other, all images of one sequence or city. Equal arguments give equal resamples, so two submissions,
evaluated at different times, can be compared on the same ones.
"""

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from evaluator.errors import UsageError
from evaluator.predictions import IndexArray

Unit = Literal["image", "sequence", "city"]
"""What is drawn as a whole: names are `<city>_<sequence>_<frame>`."""

WeightArray = NDArray[np.float32]
"""(R, I) how often each resample holds each image: whole numbers."""


def bootstrap_weights(images: tuple[str, ...], *, resamples: int, seed: int, unit: Unit = "image") -> WeightArray:
    """Draw resamples.

    Args:
        images: I image names.
        resamples: How many to draw, R.
        seed: Decides the draw.
        unit: What is drawn as a whole.

    Returns:
        (R, I) weights.
    """
    member = unit_index(images, unit)
    units = int(member.max(initial=-1)) + 1
    drawn = np.random.default_rng(seed).integers(0, units, size=(resamples, units), dtype=np.int32)
    drawn += (np.arange(resamples, dtype=np.int32) * units)[:, None]
    times = np.bincount(drawn.ravel(), minlength=resamples * units).reshape(resamples, units)
    return times[:, member].astype(np.float32)


def jackknife_weights(images: tuple[str, ...], *, unit: Unit = "image") -> WeightArray:
    """Leave out one unit at a time; (U, I) weights of 0 and 1."""
    member = unit_index(images, unit)
    units = int(member.max(initial=-1)) + 1
    return np.asarray(np.arange(units)[:, None] != member[None], dtype=np.float32)


def unit_index(images: tuple[str, ...], unit: Unit) -> IndexArray:
    """Return (I,) the number of the unit each image belongs to, counted in the order of their names.

    Raises:
        UsageError: There is no such unit.
    """
    if unit not in get_args(Unit):
        raise UsageError(f"{unit!r} cannot be drawn; choose one of {', '.join(get_args(Unit))}.")
    dropped_parts = {"image": 0, "sequence": 1, "city": 2}[unit]
    names = [image.rsplit("_", dropped_parts)[0] if dropped_parts else image for image in images]
    number = {name: index for index, name in enumerate(sorted(set(names)))}
    return np.array([number[name] for name in names], dtype=np.int32)
