"""Benchmarks, their phases and the versions of their ground truth."""

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from evaluator.protocol import EVALUATOR_VERSION
from server.models.base import Base, Blob, Slug
from server.models.people import User


class Benchmark(Base):
    """A task with its phases, for example `cityscapes3d`."""

    __tablename__ = "benchmark"

    id: Mapped[int] = mapped_column(primary_key=True)
    slug: Mapped[str] = mapped_column(Slug, unique=True)
    title: Mapped[str] = mapped_column(sa.String(200))
    description: Mapped[str] = mapped_column(default="")
    created_at: Mapped[datetime]

    phases: Mapped[list["Phase"]] = relationship(back_populates="benchmark", order_by="Phase.id")


class Phase(Base):
    """One set of ground truth with its rules, for example the hidden `test` or the open `val`."""

    __tablename__ = "phase"

    id: Mapped[int] = mapped_column(primary_key=True)
    benchmark_id: Mapped[int] = mapped_column(sa.ForeignKey(Benchmark.id))
    slug: Mapped[str] = mapped_column(Slug)
    title: Mapped[str] = mapped_column(sa.String(200))
    protocol: Mapped[str] = mapped_column(sa.String(64), default="cityscapes3d")
    """Name in `evaluator.protocol.PROTOCOLS`; it ranks."""
    evaluator_version: Mapped[str] = mapped_column(sa.String(16), default=EVALUATOR_VERSION)
    """The version in force: its scores rank before those of any other."""
    is_open: Mapped[bool] = mapped_column(default=False)
    """Open ground truth: anybody may have it, so scores say little. Shown, and nothing depends on it."""
    allows_publication: Mapped[bool] = mapped_column(default=True)
    opens_at: Mapped[datetime | None]
    closes_at: Mapped[datetime | None]
    submissions_per_day: Mapped[int] = mapped_column(default=10)
    """Scored or pending submissions of a team in any 24 hours."""
    rejections_per_day: Mapped[int] = mapped_column(default=50)
    """Rejected or cancelled uploads of a team in any 24 hours."""
    max_attempts: Mapped[int] = mapped_column(default=3)
    """Attempts that may be lost, by a lease that ran out or a scoring process that died, before a submission is failed."""
    shards: Mapped[int] = mapped_column(default=1)
    """Into how many ranges of images a submission is divided to be scored by several workers; 1: it is not."""
    ground_truth_id: Mapped[int | None] = mapped_column(
        sa.ForeignKey("ground_truth.id", use_alter=True, name="fk_phase_ground_truth_id")
    )
    """The version in force; None: the phase takes no submissions yet."""
    created_at: Mapped[datetime]

    benchmark: Mapped[Benchmark] = relationship(back_populates="phases")
    ground_truth: Mapped["GroundTruthVersion | None"] = relationship(foreign_keys=[ground_truth_id])

    __table_args__ = (
        sa.UniqueConstraint("benchmark_id", "slug"),
        sa.CheckConstraint("submissions_per_day >= 0", name="submissions_per_day_not_negative"),
        sa.CheckConstraint("rejections_per_day >= 0", name="rejections_per_day_not_negative"),
        sa.CheckConstraint("max_attempts >= 1", name="max_attempts_positive"),
        sa.CheckConstraint("shards BETWEEN 1 AND 64", name="shards_in_range"),
    )


class GroundTruthVersion(Base):
    """One imported version of a phase's hidden ground truth."""

    __tablename__ = "ground_truth"

    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[int] = mapped_column(sa.ForeignKey(Phase.id))
    version: Mapped[int]
    sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    """Prepared arrays (`GroundTruth.to_bytes`); deterministic, so this digest names the ground truth in signatures."""
    source_sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    """The imported files as one canonical zip."""
    image_list_sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    """Public part, JSON: image names and their cameras. All that leaves the worker's side."""
    image_count: Mapped[int]
    box_count: Mapped[int]
    imported_by: Mapped[int | None] = mapped_column(sa.ForeignKey(User.id))
    created_at: Mapped[datetime]

    phase: Mapped[Phase] = relationship(foreign_keys=[phase_id])

    __table_args__ = (
        sa.UniqueConstraint("phase_id", "version"),
        sa.CheckConstraint("version >= 1", name="version_positive"),
    )
