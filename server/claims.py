"""What passes between a worker and the record: its hold on a submission, and what it brings back."""

import uuid
from dataclasses import dataclass

from evaluator.integrity import IntegrityAudit
from evaluator.results import Scores


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A worker's hold on a submission: everything it needs to know, and the fence for everything it writes."""

    submission_id: uuid.UUID
    attempt: int
    """The fence."""
    worker: str
    lease_s: float
    validated: bool
    """True: the submission is in `scoring`; False: it stays `received` until `validated` is called."""
    predictions_sha256: str
    ground_truth_id: int
    ground_truth_sha256: str
    image_list_sha256: str
    protocol: str
    item_id: int | None = None
    """Of a re-scoring, when that is what is held; None: the submission itself."""
    shards: int = 1
    """Into how many ranges of images the work is divided; 1: it is not."""

    @property
    def name(self) -> str:
        """Name the attempt apart from every other one."""
        held = self.submission_id if self.item_id is None else f"rescoring-{self.item_id}"
        return f"{held}-{self.attempt}"

    @property
    def actor(self) -> str:
        """Name the worker in the audit trail."""
        return f"worker:{self.worker}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardClaim:
    """A worker's hold on a range of a submission's images."""

    submission_id: uuid.UUID
    attempt: int
    number: int
    claim: int
    """The fence."""
    lease_s: float
    predictions_sha256: str
    """The validated predictions as arrays."""
    ground_truth_sha256: str
    protocol: str
    images: range

    @property
    def name(self) -> str:
        """Name the claim apart from every other one."""
        return f"{self.submission_id}-{self.attempt}-shard-{self.number}-{self.claim}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What a worker brings back. The digests name blobs that are in the store and recorded."""

    scores: Scores
    scores_sha256: str
    statistics_sha256: str | None
    integrity: IntegrityAudit
