"""Comparison metrics as tables for the terminal."""

from client.text_table import number, percent, text_table
from evaluator.comparison.summary import ComparisonMetrics


def benchmarks_text(comparison: ComparisonMetrics) -> str:
    """Return one table for each benchmark, the signature last."""
    tables = [_kitti(comparison), _nuscenes(comparison), _waymo(comparison), _argoverse(comparison)]
    return "\n\n".join([*tables, str(comparison.signature)])


def _kitti(comparison: ComparisonMetrics) -> str:
    """Show AP_BEV and AP_3D."""
    scores = comparison.kitti
    header = ["class", *(f"{name}@{part.min_iou}" for part in scores.means for name in ("AP_BEV", "AP_3D"))]
    lines = [(score.label, score.overlaps) for score in scores.classes]
    rows = [
        [label, *(percent(ap) for part in parts for ap in (part.ap_bev, part.ap_3d))]
        for label, parts in [*lines, ("mean", scores.means)]
    ]
    return text_table("As KITTI (R40)", header, rows)


def _nuscenes(comparison: ComparisonMetrics) -> str:
    """Show AP, the errors and NDS3."""
    scores = comparison.nuscenes
    lines = [(score.label, score.ap, score.ate_m, score.ase, score.aoe_rad) for score in scores.classes]
    rows = [
        [label, percent(ap), number(ate), number(ase, 3), number(aoe, 3)]
        for label, ap, ate, ase, aoe in [*lines, ("mean", scores.map, scores.mate_m, scores.mase, scores.maoe_rad)]
    ]
    title = f"As nuScenes (NDS3 {percent(scores.nds3)}, not the NDS of nuScenes)"
    return text_table(title, ["class", "AP", "ATE m", "ASE", "AOE rad"], rows)


def _waymo(comparison: ComparisonMetrics) -> str:
    """Show AP by range and the LET metrics."""
    scores = comparison.waymo
    lines = [(score.label, score.overall, score.ranges) for score in scores.classes]
    rows = [
        [label, *map(percent, (overall.ap, *(part.ap for part in ranges), overall.let_ap, overall.let_apl))]
        for label, overall, ranges in [*lines, ("mean", scores.overall, scores.ranges)]
    ]
    ranges = [
        f"{part.lower_m:.0f}{'+' if part.upper_m is None else f'-{part.upper_m:.0f}'} m" for part in scores.ranges
    ]
    return text_table("As Waymo", ["class", "AP", *ranges, "LET-3D-AP", "LET-3D-APL"], rows)


def _argoverse(comparison: ComparisonMetrics) -> str:
    """Show AP, the errors and CDS."""
    scores = comparison.argoverse
    rows = [
        [
            score.label,
            percent(score.ap),
            number(score.ate_m),
            number(score.ase, 3),
            number(score.aoe_rad, 3),
            percent(score.cds),
        ]
        for score in scores.classes
    ]
    rows.append(["mean", percent(scores.map), "", "", "", percent(scores.mcds)])
    return text_table("As Argoverse 2", ["class", "AP", "ATE m", "ASE", "AOE rad", "CDS"], rows)
