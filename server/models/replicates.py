"""Replicates of scores: what a leaderboard needs to say how far its ranking can be trusted."""

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from server.models.base import Base
from server.models.submissions import Score


class ScoreReplicates(Base):
    """The replicates of one score. A score without this row waits for resampling (server/resampling.py)."""

    __tablename__ = "score_replicates"

    score_id: Mapped[int] = mapped_column(sa.ForeignKey(Score.id), primary_key=True)
    data: Mapped[bytes] = mapped_column(sa.LargeBinary)
    """`evaluator.score_replicates.ScoreReplicates.to_bytes`, about 60 kB. Nothing of a single image is in it.

    Empty: there are none, because of too few images, a protocol that cannot be resampled, too little memory, or too many
    tries that came to no end.
    """

    score: Mapped[Score] = relationship(back_populates="replicates")
