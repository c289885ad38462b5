"""Charts of one submission's scores, as SVG for the pages.

A chart is an Altair (Vega-Lite) specification, rendered by vl-convert without a browser. The SVG holds no style
attribute and no script, so it stands inline under a strict content security policy, and its colours are CSS custom
properties, so it follows the light and the dark theme. Every chart has its numbers in a table beside it.
"""

import hashlib
import html
import re
import uuid
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import altair as alt
import structlog
import vl_convert

from evaluator.results import ClassScore, DepthBin, Scores
from server.blobs import deleted_on_failure

log = structlog.get_logger(__name__)

CHART_VERSION = "1"
"""Part of the name of a kept chart; raised when charts look different."""

CurveMetric = Literal["bevcd", "yaw_sim", "pr_sim", "size_sim", "ap"]

Specification = dict[str, Any]
"""A Vega-Lite chart; any Vega-Lite viewer can open it as JSON."""

CURVE_TITLES: dict[CurveMetric, str] = {
    "bevcd": "BEV centre distance (BEVCD)",
    "yaw_sim": "Yaw similarity (YawSim)",
    "pr_sim": "Pitch-roll similarity (PRSim)",
    "size_sim": "Size similarity (SizeSim)",
    "ap": "Depth-dependent AP",
}
"""What is drawn over distance, in the order of the page (paper, section Benchmark Metrics)."""

PRECISION_RECALL_TITLE = "Precision over recall"

_WIDTH_PX, _HEIGHT_PX = 340, 210
_FONT = "system-ui, sans-serif"
_DASHES = ([1, 0], [6, 3], [2, 2], [8, 3, 2, 3], [4, 2, 1, 2], [10, 4])
# One image with one name: the roles of its parts would only make a screen reader stumble.
_ROLE = re.compile(r' (?:role|aria-[a-z]+)="[^"]*"')
_SHAPES = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross")


@dataclass(frozen=True, slots=True)
class Chart:
    """One drawn chart."""

    name: str
    """`ap`, `bevcd`, ..., `precision_recall`: unique on the page."""
    title: str
    svg: str
    """An SVG element for inlining; its colours are CSS custom properties of the page."""


def curve_specification(scores: Scores, metric: CurveMetric) -> Specification:
    """Draw one metric of every class over distance, one point for each 5 m bin that is defined.

    Bins without ground truth, or without a true positive for the similarities, leave a gap: an undefined value is
    never drawn as 0.
    """
    rows = [
        {"class": one.label, "distance": (bin_.lower_m + bin_.upper_m) / 2, "value": 100 * value, "run": run}
        for one in scores.classes
        for run, bins in enumerate(_defined_runs(one, metric))
        for bin_, value in bins
    ]
    far = max((bin_.upper_m for one in scores.classes for bin_ in one.depth_bins), default=100)
    distance = alt.X("distance:Q", title="Distance (m)", scale=alt.Scale(domain=[0, far], nice=False))
    return _lines(
        rows,
        x=distance,
        title="AP (%)" if metric == "ap" else "Similarity (%)",
        labels=_labels(scores),
        lowest=0.0 if metric == "ap" else _lowest_shown(rows),
        points=True,
    )


def precision_recall_specification(scores: Scores) -> Specification:
    """Draw precision over recall of every class, one point for each score threshold.

    Thresholds that no prediction reaches are left out: there the reference says precision 0 at recall 0, which would
    draw a line to the origin.
    """
    rows = [
        {"class": one.label, "recall": 100 * recall, "value": 100 * precision, "run": 0, "order": order}
        for one in scores.classes
        for order, (recall, precision) in enumerate(zip(one.recall, one.precision, strict=True))
        if recall or precision
    ]
    recall = alt.X("recall:Q", title="Recall (%)", scale=alt.Scale(domain=[0, 100]))
    return _lines(
        rows,
        x=recall,
        title="Precision (%)",
        labels=_labels(scores),
        lowest=0.0,
        points=False,
    )


def draw_all(scores: Scores) -> tuple[Chart, ...]:
    """Draw every chart of a submission page; about 0.1 s each after a start of about a second."""
    curves = [
        Chart(
            metric,
            title,
            render_svg(curve_specification(scores, metric), f"{title} over distance, one line for each class"),
        )
        for metric, title in CURVE_TITLES.items()
    ]
    recall = render_svg(precision_recall_specification(scores), f"{PRECISION_RECALL_TITLE}, one line for each class")
    return (*curves, Chart("precision_recall", PRECISION_RECALL_TITLE, recall))


def render_svg(specification: Specification, label: str) -> str:
    """Render a chart as an SVG element that scales to the width of its container and is named by `label`."""
    svg: str = vl_convert.vegalite_to_svg(specification, allowed_base_urls=[])
    head, _, body = svg.partition(">")
    # The view box keeps the proportions; a fixed size would not shrink on a phone.
    head = re.sub(r' (?:width|height|xmlns(?::xlink)?|version)="[^"]*"', "", head)
    return f'{head} role="img" aria-label="{html.escape(label)}">{_ROLE.sub("", body)}'


class ChartStore:
    """Drawn charts, kept by the digest of the scores they show: in memory, and on disk between starts."""

    def __init__(self, folder: Path) -> None:
        """Keep charts below `folder`, which is made when first needed and may be deleted at any time."""
        self._folder = folder
        self._recent = lru_cache(maxsize=64)(self._load)

    def charts(self, scores_sha256: str, scores: Scores) -> tuple[Chart, ...]:
        """Give the charts of one result, drawing them when this is the first view.

        On a full disk they are drawn, and drawn again at the next view: no page fails for want of a copy.
        """
        with suppress(FileNotFoundError):  # which the cache does not keep
            return self._recent(scores_sha256)
        drawn = draw_all(scores)
        try:
            self._keep(scores_sha256, drawn)
        except OSError as error:
            log.warning("charts_not_kept", error=repr(error))
        return drawn

    def _path(self, scores_sha256: str, name: str) -> Path:
        key = hashlib.sha256(f"{CHART_VERSION}:{scores_sha256}".encode()).hexdigest()
        return self._folder / f"{key[:32]}-{name}.svg"

    def _load(self, scores_sha256: str) -> tuple[Chart, ...]:
        """Read the charts; raises FileNotFoundError unless all were kept."""
        titles = [*CURVE_TITLES.items(), ("precision_recall", PRECISION_RECALL_TITLE)]
        return tuple(
            Chart(name, title, self._path(scores_sha256, name).read_text(encoding="utf-8")) for name, title in titles
        )

    def _keep(self, scores_sha256: str, charts: Iterable[Chart]) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        for chart in charts:
            path = self._path(scores_sha256, chart.name)
            # Written beside and renamed: a second process never reads half a chart.
            unfinished = path.with_suffix(f".{uuid.uuid4().hex}.part")
            with deleted_on_failure(unfinished):
                unfinished.write_text(chart.svg, encoding="utf-8")
                unfinished.replace(path)


def _labels(scores: Scores) -> list[str]:
    return [one.label for one in scores.classes]


def _lowest_shown(rows: list[dict[str, Any]]) -> float:
    """Start the axis at a multiple of 10 below every value, at most 90: similarities crowd near 100."""
    return min(90.0, min((10 * (row["value"] // 10) for row in rows), default=0.0))


def _defined_runs(one: ClassScore, metric: CurveMetric) -> list[list[tuple[DepthBin, float]]]:
    """Split the bins of a class into runs of neighbours that are defined, so that no line bridges a gap."""
    runs: list[list[tuple[DepthBin, float]]] = [[]]
    for bin_ in one.depth_bins:
        value: float | None = getattr(bin_, metric)
        if value is not None:
            runs[-1].append((bin_, value))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]


def _lines(
    rows: list[dict[str, Any]], *, x: alt.X, title: str, labels: list[str], lowest: float, points: bool
) -> Specification:
    """Lay out coloured, dashed lines with one legend; colour is never the only mark of a class."""
    colors = [f"var(--class-{index % 6 + 1})" for index in range(len(labels))]
    dashes = [list(_DASHES[index % 6]) for index in range(len(labels))]
    base = alt.Chart(alt.InlineData(values=rows), width=_WIDTH_PX, height=_HEIGHT_PX).encode(
        x=x,
        y=alt.Y("value:Q", title=title, scale=alt.Scale(domain=[lowest, 100])),
        color=alt.Color("class:N", scale=alt.Scale(domain=labels, range=colors), legend=None),
        detail="run:N",
    )
    line = base.mark_line(strokeWidth=1.75, aria=False).encode(
        strokeDash=alt.StrokeDash("class:N", scale=alt.Scale(domain=labels, range=dashes), legend=None),
        **({} if points else {"order": "order:Q"}),
    )
    if not points:
        return _themed(line)
    shape = alt.Shape("class:N", scale=alt.Scale(domain=labels, range=list(_SHAPES[: len(labels)])), legend=None)
    marks = base.mark_point(size=22, filled=True, opacity=1, aria=False).encode(shape=shape)
    return _themed(alt.layer(line, marks))


def _themed(chart: alt.LayerChart | alt.Chart | alt.FacetChart) -> Specification:
    axis = {
        "labelColor": "var(--muted)",
        "titleColor": "var(--muted)",
        "gridColor": "var(--line)",
        "domainColor": "var(--line-strong)",
        "tickColor": "var(--line-strong)",
        "labelFont": _FONT,
        "titleFont": _FONT,
        "labelFontSize": 11,
        "titleFontSize": 11,
        "titleFontWeight": "normal",
        "tickCount": 5,
    }
    themed = chart.configure(background="transparent", font=_FONT).configure_axis(**axis).configure_view(stroke=None)
    specification: Specification = themed.to_dict()
    return specification
