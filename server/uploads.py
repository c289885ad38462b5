"""Resumable uploads in the record: made, advanced, completed, expired. Their bytes are in part files until then."""

import uuid
from datetime import timedelta
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import database, leftovers, quota
from server.errors import NotFound, QuotaExceeded
from server.models import Team, Upload, User

LIFETIME = timedelta(hours=24)
"""From the last part."""

MAX_OPEN = 10
"""Unfinished uploads of a team."""


def folder_of(data_dir: Path) -> Path:
    """Give the folder of the part files; several web machines need a shared one, or a client that stays with one."""
    return data_dir.absolute() / "uploads"


def create(
    session: Session, *, user: User, team: Team, fields: dict[str, Any], length_bytes: int, sha256: str | None
) -> Upload:
    """Begin an upload.

    Raises:
        QuotaExceeded: The team has too many unfinished ones.
    """
    quota.lock_team(session, team.id)  # so that uploads begun at once are counted one after the other
    at = database.now(session)
    unfinished = sa.select(sa.func.count()).where(
        Upload.team_id == team.id, Upload.submission_id.is_(None), Upload.expires_at > at
    )
    if (session.scalar(unfinished) or 0) >= MAX_OPEN:
        message = f"team {team.slug} has {MAX_OPEN} unfinished uploads; finish or delete one of them"
        raise QuotaExceeded(message, retry_after_s=int(LIFETIME.total_seconds()))
    upload = Upload(
        id=uuid.uuid4(),
        user=user,
        team=team,
        fields=fields,
        length_bytes=length_bytes,
        offset_bytes=0,
        sha256=sha256,
        created_at=at,
        expires_at=at + LIFETIME,
    )
    session.add(upload)
    session.flush()
    return upload


def find(session: Session, upload_id: str, *, user: User) -> Upload:
    """Find one of the user's uploads that has not expired.

    Raises:
        NotFound: There is none.
    """
    try:
        upload = session.get(Upload, uuid.UUID(upload_id))
    except ValueError:
        upload = None
    if upload is None or upload.user_id != user.id or upload.expires_at <= database.now(session):
        raise NotFound(_missing(upload_id))
    return upload


def _missing(upload_id: str) -> str:
    return f"there is no upload {upload_id[:64]!r} of yours; it may have expired, begin a new one"


def advance(session: Session, upload_id: uuid.UUID, offset_bytes: int) -> None:
    """Record how many bytes are safe, and let the upload live on.

    Raises:
        NotFound: It expired meanwhile.
    """
    upload = session.get(Upload, upload_id)
    if upload is None:
        raise NotFound(_missing(str(upload_id)))
    upload.offset_bytes = offset_bytes
    upload.expires_at = database.now(session) + LIFETIME


def complete(session: Session, upload_id: uuid.UUID, submission_id: uuid.UUID) -> None:
    """Record what a whole upload became."""
    session.execute(sa.update(Upload).where(Upload.id == upload_id).values(submission_id=submission_id))


def delete(session: Session, upload_id: uuid.UUID) -> None:
    """Forget an upload."""
    session.execute(sa.delete(Upload).where(Upload.id == upload_id))


def sweep(session: Session, folder: Path) -> int:
    """Delete expired uploads with their part files, and part files nobody knows; never one that is being written to.

    Returns:
        How many files were deleted.
    """
    found = list(folder.glob("*.part"))  # listed first: a file is made only after its row is committed
    session.execute(sa.delete(Upload).where(Upload.expires_at <= database.now(session)))
    known = {str(key) for key in session.scalars(sa.select(Upload.id).where(Upload.submission_id.is_(None)))}
    return sum(leftovers.delete_unless_held(path) for path in found if path.stem not in known)
