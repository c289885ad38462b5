"""Users, their teams and their tokens."""

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from server.models.base import Base, Digest, Slug


class User(Base):
    """A person with an account."""

    __tablename__ = "user_account"

    id: Mapped[int] = mapped_column(primary_key=True)
    email: Mapped[str] = mapped_column(sa.String(254), unique=True)
    """Lower-cased."""
    name: Mapped[str] = mapped_column(sa.String(200))
    password_hash: Mapped[str | None]
    """Argon2id; None: cannot log in on the pages."""
    session_version: Mapped[int] = mapped_column(default=0)
    """Raised by logging out: sessions that began before are over, whoever holds their cookie."""
    is_maintainer: Mapped[bool] = mapped_column(default=False)
    created_at: Mapped[datetime]
    disabled_at: Mapped[datetime | None]

    memberships: Mapped[list["Membership"]] = relationship(back_populates="user")


class Team(Base):
    """Who submits: quota, methods and submissions belong to a team."""

    __tablename__ = "team"

    id: Mapped[int] = mapped_column(primary_key=True)
    slug: Mapped[str] = mapped_column(Slug, unique=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    created_at: Mapped[datetime]

    memberships: Mapped[list["Membership"]] = relationship(back_populates="team")


class Membership(Base):
    """A user in a team; every member may submit and publish for it."""

    __tablename__ = "membership"

    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id), primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey(User.id), primary_key=True, index=True)
    created_at: Mapped[datetime]

    team: Mapped[Team] = relationship(back_populates="memberships")
    user: Mapped[User] = relationship(back_populates="memberships")


class Token(Base):
    """An API token of a user, acting for one team. Only the SHA-256 of the secret is kept."""

    __tablename__ = "token"

    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey(User.id), index=True)
    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id))
    name: Mapped[str] = mapped_column(sa.String(200))
    secret_sha256: Mapped[str] = mapped_column(Digest, unique=True)
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]

    user: Mapped[User] = relationship()
    team: Mapped[Team] = relationship()
