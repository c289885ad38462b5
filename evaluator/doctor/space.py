"""Mistakes in the 3D boxes: order of quaternions and dimensions, frame and point of centres, yaw.

Two kinds of evidence. What every street shows: vehicles stand upright, on the road, and are longer than wide. And
the submitted 2D boxes: under the right reading the 3D boxes project into them.
"""

from collections.abc import Callable, Sequence
from itertools import permutations

import numpy as np

from evaluator.codes import Code
from evaluator.doctor.evidence import FEWEST_BOXES, Evidence
from evaluator.findings import Findings
from evaluator.orientation import rotation_matrices
from evaluator.predictions import Float64Array

TYPICAL_DIMENSIONS_M = {
    "car": (4.4, 1.8, 1.5),
    "truck": (8.0, 2.5, 3.3),
    "bus": (11.9, 2.6, 3.1),
    "train": (16.0, 2.5, 3.5),
    "motorcycle": (2.2, 0.8, 1.1),
    "bicycle": (1.8, 0.45, 1.1),
    "caravan": (6.0, 2.3, 2.7),
    "trailer": (5.0, 2.2, 2.2),
}
"""Length, width, height; only their ratios matter here (paper, table of size prototypes)."""

_UPRIGHT = 0.8
"""Cosine of the tilt: no vehicle leans by 37 degrees."""
_NEAR_M = 40.0
"""Within this depth the road is flat enough to compare heights."""
_FIT = 0.85
"""Median IoU with the 2D boxes above which nothing in the geometry is doubted."""
_GAIN = 0.15
"""How much better another reading must fit."""
_LEAST_FIT = 0.5
"""How well it must fit in the end."""
_OWN_ROAD_M = (-12.0, 2.0)
"""Lateral range of the own lane and what is right of it: with right-hand traffic they face forwards there."""


def median_overlap(evidence: Evidence) -> float | None:
    """Median IoU of projected and submitted boxes, None when there are too few to tell."""
    overlaps = evidence.overlaps
    return float(np.median(overlaps)) if len(overlaps) >= FEWEST_BOXES else None


def check_space(evidence: Evidence, findings: Findings) -> bool:
    """Look for each mistake; returns True when one explains why 2D and 3D do not fit."""
    fit = median_overlap(evidence)
    if _check_degrees(evidence, findings):
        return True
    evidence, turned = _check_quaternion_order(evidence, findings)
    evidence, reordered = _check_dimensions(evidence, findings)
    moved = _check_centers(evidence, fit, findings)
    if turned or reordered or moved:
        return True
    _check_backwards(evidence, findings)
    return _check_yaw(evidence, fit, findings)


def _recognise(code: Code, findings: Findings, confidence: float, found: str) -> None:
    """Report a recognised mistake."""
    findings.add(code, found=found)
    findings.trust(code, round(min(max(confidence, 0.0), 0.99), 2))


def _upright_share(rotation: Float64Array) -> float:
    """Share of boxes whose upper side is up."""
    return float((rotation_matrices(rotation)[2, 2] > _UPRIGHT).mean())


def _check_degrees(evidence: Evidence, findings: Findings) -> bool:
    """Angles in degrees instead of quaternions: far too long."""
    norms = np.linalg.norm(evidence.rotation, axis=1)
    share = float((norms > 2.0).mean())  # noqa: PLR2004 -- twice the length of any rounded quaternion
    if share > 0.5:  # noqa: PLR2004 -- most
        _recognise(Code.ROTATION_IN_DEGREES, findings, share, f"quaternions of length {np.median(norms):.3g}")
        return True
    return False


def _check_quaternion_order(evidence: Evidence, findings: Findings) -> tuple[Evidence, bool]:
    """Read as w, x, y, z many boxes lie on their side or back; read as x, y, z, w they stand."""
    submitted = 1.0 - _upright_share(evidence.rotation)
    reordered = evidence.with_boxes(rotation=evidence.rotation[:, [3, 0, 1, 2]])
    lying = 1.0 - _upright_share(reordered.rotation)
    if submitted < 0.1 or lying > submitted / 4:  # noqa: PLR2004 -- a tenth: no street has that many overturned
        return evidence, False
    found = f"{submitted:.0%} of the boxes lie on their side or roof, {lying:.0%} if the last number is w"
    _recognise(Code.QUATERNION_XYZW, findings, 1.0 - lying / submitted, found)
    return reordered, True


def _check_dimensions(evidence: Evidence, findings: Findings) -> tuple[Evidence, bool]:
    """Another order of the dimensions is closer to how vehicles are shaped."""
    orders = list(permutations(range(3)))  # the first one as submitted
    distances = _distances_from_typical(evidence, orders) / len(evidence)
    best = orders[int(distances.argmin())]
    gain = float(distances[0] - distances.min())
    if gain < 0.5:  # noqa: PLR2004 -- in natural logarithms over three dimensions; swapped l and w of cars give 1.8
        return evidence, False
    names = ["length", "width", "height"]
    written = ", ".join(names[best.index(place)] for place in range(3))
    _recognise(Code.DIMENSIONS_ORDER, findings, 0.5 + gain / 2, f"apparently {written}")
    return evidence.with_boxes(dimensions_m=evidence.dimensions_m[:, list(best)]), True


def _distances_from_typical(evidence: Evidence, orders: Sequence[tuple[int, ...]]) -> Float64Array:
    """For each order, sum over the boxes of how far their class's median dimensions are from the typical ones, as a logarithm."""
    distances = np.zeros(len(orders))
    for label, typical_m in TYPICAL_DIMENSIONS_M.items():
        of_class_m = evidence.dimensions_m[evidence.label == label]
        count = len(of_class_m)
        if count:
            medians_m = np.partition(of_class_m, count // 2, axis=0)[count // 2]
            distances += count * np.abs(np.log(medians_m[np.array(orders)] / typical_m)).sum(axis=1)
    return distances


def _in_vehicle_frame(evidence: Evidence, in_camera_m: Float64Array) -> Float64Array:
    """Transform (N, 3) points from the camera frame (x forward, y left, z up) to the vehicle frame."""
    rotation, translation = evidence.sensor_from_vehicle[:, :, :3], evidence.sensor_from_vehicle[:, :, 3]
    points: Float64Array = np.einsum("nji,nj->ni", rotation, in_camera_m - translation)
    return points


def _raised(center_m: Float64Array, dimensions_m: Float64Array) -> Float64Array:
    """Move centres up by half of the height."""
    raised: Float64Array = center_m + dimensions_m[:, 2:] * np.array([0.0, 0.0, 0.5])
    return raised


def _from_camera(evidence: Evidence) -> Float64Array:
    return _in_vehicle_frame(evidence, evidence.center_m)


def _from_optical(evidence: Evidence) -> Float64Array:
    right, down, forward = evidence.center_m.T
    return _in_vehicle_frame(evidence, np.stack([forward, -right, -down], axis=1))


def _from_bottom(evidence: Evidence) -> Float64Array:
    return _raised(evidence.center_m, evidence.dimensions_m)


def _from_optical_bottom(evidence: Evidence) -> Float64Array:
    return _raised(_from_optical(evidence), evidence.dimensions_m)


_READINGS: tuple[tuple[tuple[Code, ...], str, Callable[[Evidence], Float64Array]], ...] = (
    ((Code.CENTER_AT_BOTTOM,), "centres of the bottom faces", _from_bottom),
    ((Code.CENTER_IN_CAMERA_FRAME,), "camera frame with x forward, y left, z up", _from_camera),
    ((Code.CENTER_IN_CAMERA_FRAME,), "camera frame with x right, y down, z forward", _from_optical),
    (
        (Code.CENTER_IN_CAMERA_FRAME, Code.CENTER_AT_BOTTOM),
        "bottom centres in a camera frame with x right, y down, z forward",
        _from_optical_bottom,
    ),
)
"""Other readings of the centres, simplest first."""


def _check_centers(evidence: Evidence, fit: float | None, findings: Findings) -> bool:
    """Under another reading of the centres the vehicles stand on the road, and fit their 2D boxes no worse."""
    if not evidence.has_cameras:
        return False
    height = _height_above_road_m(evidence.center_m, evidence.dimensions_m)
    if height is not None and abs(height) < 0.3:  # noqa: PLR2004 -- metres; half a car's height is 0.75
        return False
    judged = []
    for codes, reading, corrected_centers in _READINGS:
        corrected = evidence.with_boxes(center_m=corrected_centers(evidence))
        there = _height_above_road_m(corrected.center_m, corrected.dimensions_m)
        overlap = median_overlap(corrected)
        if there is not None and abs(there) < 0.25 and not _fits_worse(overlap, fit):  # noqa: PLR2004 -- metres
            judged.append((_fit_gain(overlap, fit), -abs(there), codes, reading))
    if not judged:
        return False
    gain, there, codes, reading = max(judged, key=lambda one: (round(one[0], 1), one[1]))
    confidence = 0.7 + gain / 2 + there
    if confidence < 0.5:  # noqa: PLR2004 -- hardly any vehicle is near, and the 2D boxes contradict the other reading
        return False
    for code in codes:
        found = f"vehicles {'nowhere near the road' if height is None else f'{height:+.2f} m off the road'}; {reading}?"
        _recognise(code, findings, confidence, found)
    return True


def _height_above_road_m(center_m: Float64Array, dimensions_m: Float64Array) -> float | None:
    """Median height of the boxes' bottoms, of those near and in front; None when there are hardly any."""
    near = (np.hypot(center_m[:, 0], center_m[:, 1]) < _NEAR_M) & (center_m[:, 0] > 0.0)
    if near.sum() < FEWEST_BOXES:
        return None
    return float(np.median(center_m[near, 2] - dimensions_m[near, 2] / 2))


def _fit_gain(overlap: float | None, fit: float | None) -> float:
    """How much better the 2D boxes fit, 0 when unknown."""
    return 0.0 if overlap is None or fit is None else overlap - fit


def _fits_worse(overlap: float | None, fit: float | None) -> bool:
    """Tell whether a reading contradicts the 2D boxes, unless they too may be wrong."""
    return _fit_gain(overlap, fit) < -_GAIN and fit is not None and fit < _FIT


def _check_yaw(evidence: Evidence, fit: float | None, findings: Findings) -> bool:
    """Turned by a quarter the boxes fit their 2D boxes better; or no turn helps and headings are spread at random."""
    if fit is None or fit > _FIT:
        return False
    turned = median_overlap(evidence.with_boxes(rotation=_turned_by_90(evidence.rotation)))
    if turned is not None and turned > max(fit + _GAIN, _LEAST_FIT):
        found = f"median overlap with the 2D boxes {fit:.2f}, turned by 90 degrees {turned:.2f}"
        _recognise(Code.YAW_OFF_BY_90, findings, 0.5 + (turned - fit), found)
        return True
    return _check_random_headings(evidence, fit, findings)


def _turned_by_90(rotation: Float64Array) -> Float64Array:
    """Turn boxes about their own upright axis: q times (1 + k) / sqrt(2), not normalised."""
    w, x, y, z = rotation.T
    return np.stack([w - z, x + y, y - x, z + w], axis=1)


def _check_random_headings(evidence: Evidence, fit: float, findings: Findings) -> bool:
    """Degrees taken for radians turn each box at random.

    Then headings are spread evenly, fit the 2D boxes no better than those of other boxes, and some other one would.
    """
    if len(evidence) < 5 * FEWEST_BOXES or _heading_concentration(evidence.rotation) > 0.15:  # noqa: PLR2004 -- streets: 0.5
        return False
    exchanged = median_overlap(evidence.with_boxes(rotation=np.roll(evidence.rotation, len(evidence) // 2, axis=0)))
    headings = np.linspace(0.0, np.pi, 12, endpoint=False)
    best = np.maximum.reduce([_with_yaw(evidence, heading).overlaps for heading in headings])
    possible = float(np.median(best))
    if exchanged is None or fit > exchanged + 0.03 or possible < max(fit + _GAIN, _LEAST_FIT):
        return False
    found = f"headings in all directions alike; overlap with the 2D boxes {fit:.2f}, possible {possible:.2f}"
    _recognise(Code.ROTATION_IN_DEGREES, findings, 0.6, found)
    return True


def _heading_concentration(rotation: Float64Array) -> float:
    """How much headings prefer an axis, or two at right angles: 0 for evenly spread ones, 1 for parallel ones."""
    matrices = rotation_matrices(rotation)
    yaw = np.arctan2(matrices[1, 0], matrices[0, 0])
    return max(float(np.abs(np.exp(1j * fold * yaw).mean())) for fold in (2, 4))


def _with_yaw(evidence: Evidence, yaw_rad: float) -> Evidence:
    """Give every box the same heading."""
    quaternion = np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])
    return evidence.with_boxes(rotation=np.tile(quaternion, (len(evidence), 1)))


def _check_backwards(evidence: Evidence, findings: Findings) -> None:
    """With right-hand traffic most vehicles in and right of the own lane face forwards."""
    left = evidence.center_m[:, 1]
    own_road = (evidence.center_m[:, 0] > 0) & (left > _OWN_ROAD_M[0]) & (left < _OWN_ROAD_M[1])
    forward = rotation_matrices(evidence.rotation)[0, 0][own_road]
    along = np.abs(forward) > 0.9  # noqa: PLR2004 -- within 26 degrees of the own heading or its opposite
    if along.sum() < FEWEST_BOXES:
        return
    backwards = float((forward[along] < 0).mean())
    if backwards > 0.8:  # noqa: PLR2004 -- some park the other way round, hardly four of five
        found = f"{backwards:.0%} of the vehicles in and right of the own lane face backwards"
        _recognise(Code.YAW_OFF_BY_180, findings, backwards - 0.2, found)
