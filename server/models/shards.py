"""Shards: the ranges of images in which a submission of a sharded phase is matched.

What happens to them is decided in server/shards.py, not here.
"""

import uuid
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, Blob, Digest
from server.models.submissions import Attempt


class Shard(Base):
    """One range of images; it exists only while the attempt that made it runs, and holds all that a worker must know.

    Its blobs are of passing use and hold hidden ground truth's outcomes: no `Blob` row knows them, this row keeps them.
    """

    __tablename__ = "shard"

    submission_id: Mapped[uuid.UUID] = mapped_column(primary_key=True)
    attempt: Mapped[int] = mapped_column(primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    """From 0, in the order of the images."""
    first_image: Mapped[int]
    end_image: Mapped[int]
    """The first that is not in the range."""
    predictions_sha256: Mapped[str] = mapped_column(Digest)
    """The validated predictions as arrays (`Predictions.to_bytes`)."""
    ground_truth_sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    protocol: Mapped[str] = mapped_column(sa.String(64))

    claims: Mapped[int] = mapped_column(default=0)
    """Number of the latest claim: the fence of what its worker writes."""
    returned: Mapped[int] = mapped_column(default=0)
    """Claims that were given back unharmed; the others count against the cap."""
    worker: Mapped[str | None] = mapped_column(sa.String(255))
    """Of the latest claim."""
    lease_expires_at: Mapped[datetime | None]
    """Set exactly while a worker holds the shard; the database's clock."""
    result_sha256: Mapped[str | None] = mapped_column(Digest)
    """The range's statistics (`evaluator.sharding.shard_to_bytes`). Never leaves the worker's side."""
    failure_code: Mapped[str | None] = mapped_column(sa.String(64))
    """Why the latest claim was lost, where its worker could say so."""
    failure_detail: Mapped[str | None]

    __table_args__ = (
        sa.ForeignKeyConstraint(["submission_id", "attempt"], [Attempt.submission_id, Attempt.number]),
        sa.CheckConstraint("number >= 0", name="number_not_negative"),
        sa.CheckConstraint("first_image >= 0 AND first_image < end_image", name="has_images"),
        sa.CheckConstraint("returned BETWEEN 0 AND claims", name="returned_claims_happened"),
        sa.CheckConstraint("lease_expires_at IS NULL OR worker IS NOT NULL", name="lease_has_worker"),
        sa.CheckConstraint("result_sha256 IS NULL OR lease_expires_at IS NULL", name="result_ends_lease"),
        sa.CheckConstraint("(failure_code IS NULL) = (failure_detail IS NULL)", name="failure_is_explained"),
    )
