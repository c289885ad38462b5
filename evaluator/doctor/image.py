"""Mistakes in the 2D boxes: corners instead of sizes, another image size, modal outside of amodal, far away."""

import numpy as np

from evaluator.codes import Code
from evaluator.doctor.evidence import FEWEST_BOXES, Evidence
from evaluator.doctor.space import median_overlap
from evaluator.findings import Findings
from evaluator.predictions import Float64Array
from evaluator.projection import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX

_KITTI_SIZE_PX = (1242.0, 375.0)
_SLACK_PX = 3.0
"""Rounding of two boxes to whole pixels, and a little more."""
_GAIN = 0.15
_FAR = 0.1
"""IoU below which a 2D box has nothing to do with its 3D box."""


def check_image(evidence: Evidence, findings: Findings, *, explained: bool) -> None:
    """Look for each mistake; `explained`: the 3D boxes are known to be wrong, so that nothing is said about the fit."""
    if _check_corners(evidence, findings):
        return
    _check_modal(evidence, findings)
    if not _check_image_size(evidence, findings) and not explained:
        _check_distance(evidence, findings)


def _check_modal(evidence: Evidence, findings: Findings) -> None:
    """Modal boxes are parts of amodal ones."""
    amodal, modal = evidence.amodal_px, evidence.modal_px
    outside = (modal[:, :2] < amodal[:, :2] - _SLACK_PX).any(axis=1)
    outside |= (modal[:, :2] + modal[:, 2:] > amodal[:, :2] + amodal[:, 2:] + _SLACK_PX).any(axis=1)
    share = float(outside.mean())
    if share > 0.05:  # noqa: PLR2004 -- two detectors for the two boxes disagree now and then
        findings.add(Code.MODAL_OUTSIDE_AMODAL, found=f"{share:.0%} of the boxes")
        findings.trust(Code.MODAL_OUTSIDE_AMODAL, 0.99)


def _corners_to_sizes(box_px: Float64Array) -> Float64Array:
    """Read x1, y1, x2, y2."""
    return np.concatenate([box_px[:, :2], box_px[:, 2:] - box_px[:, :2]], axis=1)


def _check_corners(evidence: Evidence, findings: Findings) -> bool:
    """As x, y, width, height the boxes leave the image; as two corners they fit into it and their 3D boxes."""
    box = evidence.amodal_px
    ordered = (box[:, 2:] >= box[:, :2]).all(axis=1)
    leaving = (box[:, 0] + box[:, 2] > IMAGE_WIDTH_PX + 1) | (box[:, 1] + box[:, 3] > IMAGE_HEIGHT_PX + 1)
    if ordered.mean() < 0.95 or leaving.mean() < 0.2:  # noqa: PLR2004 -- honest boxes are clipped to the image
        return False
    fit = median_overlap(evidence)
    as_corners = median_overlap(evidence.with_boxes(amodal_px=_corners_to_sizes(box)))
    if fit is not None and as_corners is not None and as_corners < fit:
        return False
    findings.add(Code.BOXES_AS_CORNERS, found=f"{leaving.mean():.0%} of the boxes reach out of the image")
    findings.trust(Code.BOXES_AS_CORNERS, round(min(0.99, 0.6 + float(leaving.mean()) / 2), 2))
    return True


def _check_image_size(evidence: Evidence, findings: Findings) -> bool:
    """All boxes lie in the upper left 1242 x 375 pixels, and fit once scaled."""
    end = evidence.amodal_px[:, :2] + evidence.amodal_px[:, 2:]
    if (end > np.array(_KITTI_SIZE_PX) + 1).any(axis=1).mean() > 0.01:  # noqa: PLR2004 -- hardly any
        return False
    scale = np.array([IMAGE_WIDTH_PX / _KITTI_SIZE_PX[0], IMAGE_HEIGHT_PX / _KITTI_SIZE_PX[1]] * 2)
    fit = median_overlap(evidence)
    scaled = median_overlap(evidence.with_boxes(amodal_px=evidence.amodal_px * scale))
    if fit is None or scaled is None or scaled < fit + _GAIN:
        return False
    findings.add(Code.BOXES_FOR_OTHER_IMAGE_SIZE, found=f"overlap {fit:.2f}, scaled to 2048 x 1024 {scaled:.2f}")
    findings.trust(Code.BOXES_FOR_OTHER_IMAGE_SIZE, round(min(0.99, 0.5 + scaled - fit), 2))
    return True


def _check_distance(evidence: Evidence, findings: Findings) -> None:
    """Many 2D boxes have nothing to do with where their 3D boxes project to."""
    if len(evidence.overlaps) < FEWEST_BOXES:
        return
    share = float((evidence.overlaps < _FAR).mean())
    if share > 0.4:  # noqa: PLR2004 -- far more than bad regression explains
        findings.add(Code.BOXES_FAR_FROM_PROJECTION, found=f"{share:.0%} of the boxes overlap by less than {_FAR}")
        findings.trust(Code.BOXES_FAR_FROM_PROJECTION, round(0.5 + share / 2.1, 2))
