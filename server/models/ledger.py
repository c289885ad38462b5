"""The quota: an append-only ledger."""

import uuid
from datetime import datetime
from enum import StrEnum

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, checked_enum
from server.models.benchmarks import Phase
from server.models.people import Team
from server.models.submissions import Submission


class QuotaKind(StrEnum):
    """What an entry of the quota ledger does to a team's count in a phase."""

    RESERVE = "reserve"
    """+1 when a submission is received."""
    CHARGE = "charge"
    """0: the reservation became final, the submission is scored."""
    REFUND = "refund"
    """-1: rejected, failed or cancelled."""
    GRANT = "grant"
    """-n: a maintainer allows n more."""


class QuotaEntry(Base):
    """One line of a team's ledger in a phase; append-only."""

    __tablename__ = "quota_entry"

    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id))
    phase_id: Mapped[int] = mapped_column(sa.ForeignKey(Phase.id))
    submission_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey(Submission.id))
    kind: Mapped[QuotaKind] = mapped_column(checked_enum(QuotaKind, "quota_kind"))
    amount: Mapped[int]
    reason: Mapped[str]
    created_at: Mapped[datetime]

    __table_args__ = (
        sa.Index(None, "team_id", "phase_id", "created_at"),
        sa.CheckConstraint(
            "(kind = 'reserve' AND amount = 1) OR (kind = 'charge' AND amount = 0)"
            " OR (kind = 'refund' AND amount = -1) OR (kind = 'grant' AND amount < 0)",
            name="amount_matches_kind",
        ),
        sa.CheckConstraint("(kind = 'grant') = (submission_id IS NULL)", name="submission_unless_grant"),
        # Reserved once, charged once, refunded once, whatever is delivered twice.
        sa.UniqueConstraint("submission_id", "kind"),
    )
