"""A diagnosis as tables for the terminal: what costs points, errors against distance, oracles."""

from client.score_text import zeroed_note
from client.text_table import UNDEFINED, number, percent, points, text_table
from evaluator.diagnosis.annotator_noise import AnnotatorNoise
from evaluator.diagnosis.diagnose import Accuracy, ClassDiagnosis, Diagnosis
from evaluator.diagnosis.errors import DistanceRange
from evaluator.errors import UsageError
from evaluator.results import ClassScore, Scores

Row = tuple[str, ...]


def diagnosis_text(scores: Scores, diagnosis: Diagnosis, label: str | None = None) -> str:
    """Return the tables, the signature last.

    Args:
        scores: What is explained.
        diagnosis: The explanation.
        label: The class whose errors and kinds of objects are shown; None for all together.

    Raises:
        UsageError: There is no such class, or no ground truth of it.
    """
    defined = [
        (score, part) for score, part in zip(scores.classes, diagnosis.classes, strict=True) if part.causes is not None
    ]
    what, accuracy = _chosen(diagnosis, label)
    tables = [
        _loss_table(defined),
        *filter(None, [zeroed_note(scores.zeroed_labels)]),
        _cause_table(defined),
        _oracle_table(scores, diagnosis),
        _error_table(what, accuracy, diagnosis.annotator_noise),
        _subset_table(what, accuracy),
        _score_table(defined),
        _reliability_table(defined),
    ]
    return "\n\n".join([*tables, str(diagnosis.signature)])


def _chosen(diagnosis: Diagnosis, label: str | None) -> tuple[str, Accuracy]:
    """Name one class or all, and return their errors."""
    if label is None:
        return "all classes", diagnosis.accuracy
    known = {part.label: part.accuracy for part in diagnosis.classes if part.accuracy is not None}
    if label not in known:
        raise UsageError(f"There is no ground truth of the class {label!r}; choose one of {', '.join(known)}.")
    return label, known[label]


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


def _error_table(what: str, accuracy: Accuracy, annotator_noise: tuple[AnnotatorNoise, ...]) -> str:
    """Show mean errors up to each tenth metre beside the annotators'."""
    noise = {part.up_to_m: part for part in annotator_noise}
    rows = [_error_row(part, noise[part.upper_m]) for part in accuracy.curves.up_to_distance if part.upper_m in noise]
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
        "pitch deg",
        "roll deg",
        "size %",
    )
    return text_table(f"Mean errors of {what}, beside people's", header, rows)


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
        number(mean.pitch_deg),
        number(mean.roll_deg),
        number(mean.size_percent),
    )


def _subset_table(what: str, accuracy: Accuracy) -> str:
    """Show recall and errors by kinds of objects."""
    rows = [
        (
            f"{grouping.name.replace('_', ' ')}: {subset.name}",
            str(subset.ground_truth_count),
            percent(subset.recall),
            number(subset.errors.mean.center_m),
            number(subset.errors.mean.yaw_deg),
            number(subset.errors.mean.size_percent),
        )
        for grouping in accuracy.groupings
        for subset in grouping.subsets
    ]
    header = ("kind", "boxes", "recall %", "centre m", "yaw deg", "size %")
    return text_table(f"{what[0].upper()}{what[1:]} by kind of object", header, rows)


def _reliability_table(classes: list[tuple[ClassScore, ClassDiagnosis]]) -> str:
    """Show how often scores are right."""
    curves = [(score.label, part.calibration.reliability) for score, part in classes if part.calibration is not None]
    edges = [f"{part.lower:.1f}-{part.upper:.1f}" for _, curve in curves[:1] for part in curve]
    rows = [(label, *(percent(part.precision, 0) for part in curve)) for label, curve in curves]
    return text_table("How many of the predictions are right, in percent, by their score", ("class", *edges), rows)


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
