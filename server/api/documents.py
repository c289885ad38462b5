"""What the API answers, as typed values: one definition for the JSON and for OpenAPI.

Numbers are in full precision; undefined is null.
"""

from datetime import datetime
from typing import Literal

import msgspec

from evaluator.integrity import IntegrityAudit
from evaluator.report import Report
from evaluator.results import Scores

Stage = Literal["validating", "scoring"]


class Progress(msgspec.Struct, frozen=True, kw_only=True):
    """What the worker is doing."""

    stage: Stage
    images_done: int
    images_total: int


class PredictionsFile(msgspec.Struct, frozen=True, kw_only=True):
    """The uploaded archive."""

    sha256: str
    size_bytes: int
    file_name: str | None
    """As its uploader named it; for the team and maintainers."""


class Failure(msgspec.Struct, frozen=True, kw_only=True):
    """Why a submission failed on our side."""

    code: str
    detail: str


class Links(msgspec.Struct, frozen=True, kw_only=True):
    """Where to go from a submission."""

    self: str
    results: str
    events: str
    page: str


class SubmissionDocument(msgspec.Struct, frozen=True, kw_only=True):
    """One submission and where it is in its life."""

    id: str
    benchmark: str
    phase: str
    method: str
    method_name: str
    team: str
    state: Literal["received", "queued", "scoring", "scored", "rejected", "failed", "cancelled"]
    terminal: bool
    """True when nothing happens by itself any more: stop polling."""
    created_at: datetime
    state_changed_at: datetime
    attempt: int
    progress: Progress | None
    publication: Literal["private", "published", "withdrawn"]
    held: str | None
    """Why a maintainer must look before it may be published; for the team and maintainers."""
    predictions: PredictionsFile
    failure: Failure | None
    report: Report | None
    """What was found in the predictions, once they are validated; for the team and maintainers."""
    mds: float | None
    signature: str | None
    """What the mDS depends on; null before there is one."""
    links: Links


class SubmissionSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One submission in a list."""

    id: str
    benchmark: str
    phase: str
    method: str
    team: str
    state: str
    terminal: bool
    created_at: datetime
    publication: str
    mds: float | None
    links: Links


class SubmissionList(msgspec.Struct, frozen=True, kw_only=True):
    """Submissions, latest first."""

    submissions: list[SubmissionSummary]


class ScoreEntry(msgspec.Struct, frozen=True, kw_only=True):
    """One score of a submission; none is ever changed or taken away."""

    id: int
    mds: float | None
    signature_text: str
    created_at: datetime
    ranks: bool
    """True for the one under the protocol, evaluator and ground truth in force."""


class ResultsDocument(Scores, frozen=True, kw_only=True):
    """All numbers of one score of a submission, with the signature that makes them reproducible."""

    signature_text: str
    """The signature on one line, for citing."""
    history: list[ScoreEntry]
    """Every score of the submission, oldest first; `?score=<id>` gives the numbers of another one."""


class ClassSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One class of a leaderboard row."""

    ap: float | None
    bevcd: float | None
    yaw_sim: float | None
    pr_sim: float | None
    size_sim: float | None
    detection_score: float | None


class LeaderboardRow(msgspec.Struct, frozen=True, kw_only=True):
    """One method with its published submission."""

    rank: int | None
    """Equal scores share a rank; null for an undefined mDS, which is listed last."""
    method: str
    method_name: str
    paper_url: str | None
    code_url: str | None
    team: str
    team_name: str
    submission_id: str
    mds: float | None
    mds_interval: tuple[float, float] | None
    """95 % confidence interval of mDS over the images; null where too little is known for one."""
    rank_interval: tuple[int, int] | None
    """Best and worst rank at 95 % confidence; null for scores made before this was known."""
    groups: tuple[str, ...]
    """Letters: methods that share one cannot be told apart at 95 % confidence."""
    map: float | None
    mbevcd: float | None
    myaw_sim: float | None
    mpr_sim: float | None
    msize_sim: float | None
    created_at: datetime
    signature: str
    classes: dict[str, ClassSummary]
    """By label, in the protocol's order."""
    links: Links


class LeaderboardDocument(msgspec.Struct, frozen=True, kw_only=True):
    """The published methods of a phase, best mDS first."""

    benchmark: str
    phase: str
    protocol: str
    rows: list[LeaderboardRow]


class PhaseDocument(msgspec.Struct, frozen=True, kw_only=True):
    """One phase and its rules."""

    slug: str
    title: str
    protocol: str
    is_open: bool
    """True when the ground truth is public."""
    allows_publication: bool
    opens_at: datetime | None
    closes_at: datetime | None
    submissions_per_day: int
    images: int | None
    """Null: the phase takes no submissions yet."""


class BenchmarkDocument(msgspec.Struct, frozen=True, kw_only=True):
    """One benchmark and its phases."""

    slug: str
    title: str
    description: str
    phases: list[PhaseDocument]


class BenchmarkList(msgspec.Struct, frozen=True, kw_only=True):
    """All benchmarks."""

    benchmarks: list[BenchmarkDocument]


class UploadDocument(msgspec.Struct, frozen=True, kw_only=True):
    """A resumable upload."""

    id: str
    offset: int
    """Bytes that are safe."""
    length: int
    expires_at: datetime
    complete: bool
    submission_id: str | None
    """What the upload became, once it is complete."""


class ImagesDocument(msgspec.Struct, frozen=True, kw_only=True):
    """The images of a phase with their cameras: `evaluator.ground_truth.ImageList` as JSON."""

    images: list[str]
    """Names, sorted."""
    intrinsics_px: list[list[float]]
    """fx, fy, u0, v0 of each."""
    sensor_from_vehicle: list[list[list[float]]]
    """3 rows of 4: the ISO 8855 vehicle frame to the camera frame."""


class HealthDocument(msgspec.Struct, frozen=True, kw_only=True):
    """The server can do its work."""

    status: Literal["ok"]


EXPOSED = (
    SubmissionDocument,
    SubmissionList,
    ResultsDocument,
    LeaderboardDocument,
    BenchmarkList,
    UploadDocument,
    IntegrityAudit,
    ImagesDocument,
    HealthDocument,
)
"""Every type an endpoint answers with, for OpenAPI."""
