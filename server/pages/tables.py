"""What the tables of scores show: columns, sorting and the best of each column."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import urlencode

from sqlalchemy.orm import Session

from evaluator.uncertainty import Comparison
from server import ranking, standings
from server.models import Score
from server.ranking import LeaderboardRow, scores_of

Metric = Literal["detection_score", "ap", "bevcd", "yaw_sim", "pr_sim", "size_sim"]

METRICS: dict[Metric, str] = {
    "detection_score": "DS",
    "ap": "AP",
    "bevcd": "BEVCD",
    "yaw_sim": "YawSim",
    "pr_sim": "PRSim",
    "size_sim": "SizeSim",
}

METRIC_NAMES: dict[Metric, str] = {
    "detection_score": "Detection score",
    "ap": "2D average precision",
    "bevcd": "BEV centre distance",
    "yaw_sim": "Yaw similarity",
    "pr_sim": "Pitch-roll similarity",
    "size_sim": "Size similarity",
}

MEANS = {
    "mds": "mDS",
    "map": "mAP",
    "mbevcd": "mBEVCD",
    "myaw_sim": "mYawSim",
    "mpr_sim": "mPRSim",
    "msize_sim": "mSizeSim",
}

BIN_METRICS: dict[str, str] = {name: title for name, title in METRICS.items() if name != "detection_score"}
"""What is measured per distance; a detection score is not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """What the visitor chose, from the query of the address."""

    sort: str
    order: Literal["asc", "desc"]
    metric: Metric
    label: str
    bin_metric: str

    @classmethod
    def from_query(cls, query: Mapping[str, str], labels: Sequence[str]) -> "View":
        """Read a choice; whatever is not known falls back to the default."""
        metric: Metric = next((name for name in METRICS if name == query.get("metric")), "detection_score")
        sort = query.get("sort", "rank")
        known = {"rank", "method", "date", *MEANS, *labels}
        return cls(
            sort=sort if sort in known else "rank",
            order="asc" if query.get("order") == "asc" else "desc",
            metric=metric,
            label=query.get("class", "") if query.get("class") in labels else (labels[0] if labels else ""),
            bin_metric=query.get("distance", "") if query.get("distance") in BIN_METRICS else "ap",
        )

    def address(self, **changes: str) -> str:
        """Give the query of this view with changes."""
        now = {
            "sort": self.sort,
            "order": self.order,
            "metric": self.metric,
            "class": self.label,
            "distance": self.bin_metric,
        }
        return "?" + urlencode({**now, **changes})

    def sort_address(self, key: str) -> str:
        """Give the query that sorts by a column; by the column in use, the other way round."""
        default = "asc" if key in ("rank", "method") else "desc"
        turned = "asc" if self.order == "desc" else "desc"
        return self.address(sort=key, order=turned if key == self.sort else default)

    def aria_sort(self, key: str) -> str | None:
        """Name the order of a column for `aria-sort`; None when the table is not sorted by it."""
        if key != self.sort:
            return None
        return "ascending" if self.order == "asc" or key == "rank" else "descending"


def labels_of(rows: Sequence[LeaderboardRow]) -> list[str]:
    """List the classes of a leaderboard, in the protocol's order."""
    return [one["label"] for one in rows[0].summary["classes"]] if rows else []


def class_value(row: LeaderboardRow, label: str, metric: str) -> float | None:
    """Give one class's value of a row."""
    value: float | None = next((one[metric] for one in row.summary["classes"] if one["label"] == label), None)
    return value


def difference(first: float | None, second: float | None) -> float | None:
    """Subtract the first value from the second; undefined when either is."""
    return None if first is None or second is None else second - first


def significance(
    session: Session, left: LeaderboardRow, right: LeaderboardRow, labels: Sequence[str]
) -> dict[str, Comparison | None]:
    """Judge the differences of two rows, right minus left: of mDS, and of each class's detection score by its label."""
    kept = standings.replicates_of(session, [left, right])
    pair = kept.get(left.submission.id), kept.get(right.submission.id)
    of_mds = standings.comparison(*pair, difference(left.mds, right.mds))
    by_label = {
        label: standings.class_comparison(
            *pair,
            difference(*(class_value(row, label, "detection_score") for row in (left, right))),
            label,
            boxes=class_value(left, label, "ground_truth_count") or 0,
        )
        for label in labels
    }
    return {"mds": of_mds, **by_label}


def bins_of(row: LeaderboardRow, label: str) -> list[dict[str, Any]]:
    """Give the depth bins of one class of a row."""
    bins: list[dict[str, Any]] = next(
        (one["depth_bins"] for one in row.summary["classes"] if one["label"] == label), []
    )
    return bins


def zeroed_labels(row: LeaderboardRow) -> tuple[str, ...]:
    """Name the classes of a row whose detection score a rule makes 0 (`Scores.zeroed_labels`)."""
    return scores_of(row.summary).zeroed_labels


def signature_of(row: LeaderboardRow | Score) -> str:
    """Print the signature of a score."""
    return ranking.signature_of(row.summary)


def sorted_rows(rows: Sequence[LeaderboardRow], view: View) -> list[LeaderboardRow]:
    """Sort rows as the view says: stable, undefined values last in either direction."""
    if view.sort == "rank":
        return list(rows)
    key = _key(view)
    defined = [row for row in rows if key(row) is not None]
    undefined = [row for row in rows if key(row) is None]
    return [*sorted(defined, key=key, reverse=view.order == "desc"), *undefined]


def best_values(rows: Sequence[LeaderboardRow], labels: Sequence[str], metric: str) -> dict[str, float]:
    """Find the greatest value of every column that has one."""
    columns = {name: [row.summary[name] for row in rows] for name in MEANS}
    columns |= {label: [class_value(row, label, metric) for row in rows] for label in labels}
    defined = {name: [value for value in values if value is not None] for name, values in columns.items()}
    return {name: max(values) for name, values in defined.items() if values}


def _key(view: View) -> Callable[[LeaderboardRow], Any]:
    if view.sort == "method":
        return lambda row: row.method.name.lower()
    if view.sort == "date":
        return lambda row: row.submission.created_at
    if view.sort in MEANS:
        return lambda row: row.summary[view.sort]
    return lambda row: class_value(row, view.sort, view.metric)
