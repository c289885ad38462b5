"""A diagnosis as tables for the terminal: what costs points, errors against distance, oracles."""

from client.text_table import UNDEFINED, number, percent, points, text_table
from evaluator.diagnosis.annotator_noise import AnnotatorNoise
from evaluator.diagnosis.diagnose import ClassDiagnosis, Diagnosis
from evaluator.diagnosis.errors import DistanceRange
from evaluator.results import ClassScore, Scores

Row = tuple[str, ...]


def diagnosis_text(scores: Scores, diagnosis: Diagnosis) -> str:
    """Return the tables, the signature last."""
    defined = [
        (score, part) for score, part in zip(scores.classes, diagnosis.classes, strict=True) if part.causes is not None
    ]
    tables = [
        _loss_table(defined),
        _cause_table(defined),
        _oracle_table(scores, diagnosis),
        _error_table(diagnosis),
        _subset_table(diagnosis),
        _score_table(defined),
    ]
    return "\n\n".join([*tables, str(diagnosis.signature)])


def _loss_table(classes: list[tuple[ClassScore, ClassDiagnosis]]) -> str:
    """Show the exact split of 100 points."""
    rows = [
        (
            score.label,
            percent(score.detection_score),
            *map(points, (-p.ap, -p.bevcd, -p.yaw_sim, -p.pr_sim, -p.size_sim)),
        )
        for score, part in classes
        for p in [part.loss]
        if p is not None
    ]
    header = ("class", "DS", "AP", "BEVCD", "YawSim", "PRSim", "SizeSim")
    return text_table(
        "Where 100 points go: the detection score, and exactly what each part takes away from 100", header, rows
    )


def _cause_table(classes: list[tuple[ClassScore, ClassDiagnosis]]) -> str:
    """Show counts and costs of each cause."""
    rows: list[Row] = []
    for score, part in classes:
        if part.causes is not None:
            cells = (f"{cause.count} ({points(cause.ap_gain)})" for cause in part.causes.causes)
            rows.append((score.label, str(part.causes.true_positive_count), *cells))
    names = ("duplicate", "class", "2D place", "both", "ignore reg.", "background", "missed")
    return text_table("Causes: count at the working point (AP if repaired)", ("class", "right", *names), rows)


def _oracle_table(scores: Scores, diagnosis: Diagnosis) -> str:
    """Show what the mDS would be with one thing perfect."""
    rows = [(oracle.name.replace("_", " "), percent(oracle.mds), points(oracle.gain)) for oracle in diagnosis.oracles]
    return text_table(f"Oracles (mDS is {percent(scores.mds)})", ("with", "mDS", "gain"), rows)


def _error_table(diagnosis: Diagnosis) -> str:
    """Show mean errors up to each tenth metre beside the annotators'."""
    noise = {part.up_to_m: part for part in diagnosis.annotator_noise}
    rows = [
        _error_row(part, noise[part.upper_m])
        for part in diagnosis.accuracy.curves.up_to_distance
        if part.upper_m in noise
    ]
    header = (
        "up to m",
        "found",
        "centre m",
        "(people)",
        "lateral m",
        "along m",
        "depth %",
        "yaw deg",
        "(people)",
        "size %",
    )
    return text_table("Mean errors of all classes, beside people's", header, rows)


def _error_row(part: DistanceRange, noise: AnnotatorNoise) -> Row:
    """Show one range."""
    mean = part.errors.mean
    return (
        "all" if part.upper_m is None else f"{part.upper_m:.0f}",
        str(part.errors.true_positive_count),
        number(mean.center_m),
        number(noise.center_m),
        number(mean.lateral_m),
        number(mean.longitudinal_m),
        number(mean.depth_percent),
        number(mean.yaw_deg),
        number(noise.yaw_deg),
        number(mean.size_percent),
    )


def _subset_table(diagnosis: Diagnosis) -> str:
    """Show recall by kinds of objects."""
    rows = [
        (
            f"{grouping.name.replace('_', ' ')}: {subset.name}",
            str(subset.ground_truth_count),
            percent(subset.recall),
            number(subset.errors.mean.center_m),
            number(subset.errors.mean.yaw_deg),
        )
        for grouping in diagnosis.accuracy.groupings
        for subset in grouping.subsets
    ]
    return text_table("All classes by kind of object", ("kind", "boxes", "recall %", "centre m", "yaw deg"), rows)


def _score_table(classes: list[tuple[ClassScore, ClassDiagnosis]]) -> str:
    """Show what scores mean."""
    rows: list[Row] = []
    for score, part in classes:
        if part.calibration is not None:
            resolution = part.calibration.resolution
            levels = f"{resolution.used_level_count} of {resolution.level_count}"
            error = part.calibration.expected_calibration_error
            worst = max(part.calibration.depth_working_points, key=lambda point: point.loss, default=None)
            where = UNDEFINED if worst is None else f"{percent(worst.loss)} at {worst.lower_m}-{worst.upper_m} m"
            aps = percent(resolution.ap), percent(resolution.ap_all_scores)
            rows.append((score.label, number(score.working_point), percent(error), where, levels, *aps))
    header = ("class", "c_w", "calibration error %", "c_w costs most (p x r)", "score levels", "AP", "AP all scores")
    return text_table("Scores", header, rows)
