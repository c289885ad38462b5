"""The record: every table, with the constraints that make illegal rows impossible.

Rows refer to bytes by digest through `Blob`; times are UTC; the quota and the audit trail are append-only.
"""

from server.models.base import NAMING_CONVENTION, AuditEvent, Base, Blob, UtcDateTime
from server.models.benchmarks import Benchmark, GroundTruthVersion, Phase
from server.models.ledger import QuotaEntry, QuotaKind
from server.models.people import Membership, Team, Token, User
from server.models.replicates import ScoreReplicates
from server.models.rescoring import ItemState, Rescoring, RescoringItem, RescoringState
from server.models.shards import Shard
from server.models.submissions import (
    TERMINAL_STATES,
    Attempt,
    AttemptOutcome,
    Method,
    Publication,
    Score,
    Submission,
    SubmissionState,
    Upload,
)

__all__ = [
    "NAMING_CONVENTION",
    "TERMINAL_STATES",
    "Attempt",
    "AttemptOutcome",
    "AuditEvent",
    "Base",
    "Benchmark",
    "Blob",
    "GroundTruthVersion",
    "ItemState",
    "Membership",
    "Method",
    "Phase",
    "Publication",
    "QuotaEntry",
    "QuotaKind",
    "Rescoring",
    "RescoringItem",
    "RescoringState",
    "Score",
    "ScoreReplicates",
    "Shard",
    "Submission",
    "SubmissionState",
    "Team",
    "Token",
    "Upload",
    "User",
    "UtcDateTime",
]
