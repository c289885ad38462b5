"""How well people label: the annotation errors the paper measured, to read error curves against.

Paper, figure "Labeling quality evaluation" (labelling with the stereo bird's-eye view): 20 relabelled Synscapes images
against the synthetic truth, mean error of all objects up to a distance. No prediction can be shown to be better than
this, because the ground truth itself is not.
"""

import msgspec


class AnnotatorNoise(msgspec.Struct, frozen=True, kw_only=True):
    """Mean annotation errors of all objects up to a distance."""

    up_to_m: float | None
    """None: all distances."""
    yaw_deg: float
    center_m: float


_UP_TO_M = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0, None)
_YAW_DEG = (1.78, 1.18, 1.16, 1.95, 2.06, 2.06, 2.08, 2.07, 2.07, 2.07, 2.09)
_CENTER_M = (0.61, 0.64, 0.68, 0.81, 0.89, 0.93, 0.93, 0.94, 0.94, 0.94, 0.75)

ANNOTATOR_NOISE = tuple(
    AnnotatorNoise(up_to_m=up_to_m, yaw_deg=yaw_deg, center_m=center_m)
    for up_to_m, yaw_deg, center_m in zip(_UP_TO_M, _YAW_DEG, _CENTER_M, strict=True)
)
