"""From bytes to a submission: what every way of uploading shares.

    admit      who, for which phase and team: asked before the first byte is read
    (spool)    the body goes to disk, hashed and capped on the way
    keep       framing check, promotion to a blob, one transaction, then the message to the workers

Nothing is recorded and no quota is used until `keep` commits.
"""

import uuid
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.intake import check_archive
from evaluator.limits import ANY_SIZE
from server import accounts, benchmarks, quota, submissions
from server.api.errors import ArchiveRefused
from server.api.identity import Identity
from server.api.orders import Order
from server.api.spool import SpooledFile
from server.errors import Forbidden, IdempotencyMismatch, InvalidField
from server.models import Phase, Team, User
from server.services import Services

MAX_KEY_CHARACTERS = 255


@dataclass(frozen=True, slots=True)
class Admission:
    """Who sends, once it is known that the upload may begin."""

    user_id: int
    team_id: int
    actor: str


def admit(session: Session, identity: Identity, order: Order) -> Admission:
    """Refuse an upload that could not become a submission before its bytes are sent.

    What was made under the same Idempotency-Key before is answered again, whatever has closed or run out meanwhile.

    Raises:
        NotFound: There is no such phase.
        PhaseClosed: It takes no submissions now.
        Forbidden: The user has no such team.
        QuotaExceeded: The team may not send more now.
        InvalidField: The method's name cannot be used, or the team is not said.
    """
    phase = benchmarks.find_phase(session, order.benchmark, order.phase)
    accounts.checked_slug("method", order.method)
    if order.idempotency_key is not None and not 0 < len(order.idempotency_key) <= MAX_KEY_CHARACTERS:
        raise InvalidField(f"idempotency-key must have 1 to {MAX_KEY_CHARACTERS} characters")
    team = _team_of(session, identity, order.team)
    key = order.idempotency_key
    if key is None or submissions.sent_under(session, identity.user.id, key) is None:
        _check_room_for_one(session, team, phase)
    return Admission(identity.user.id, team.id, identity.actor)


def keep(services: Services, admission: Admission, order: Order, spooled: SpooledFile) -> uuid.UUID:
    """Make a submission of a whole upload and tell the workers.

    Blocks on the disk, the blob store, the database and the broker: call it on a thread.

    Raises:
        ArchiveRefused: The archive breaks the framing rules; carries the report and costs nothing.
        IdempotencyMismatch: The key was used for another upload.
        QuotaExceeded: The team may not send more now.
    """
    report = check_archive(spooled.path, ANY_SIZE)  # the spool, or the announced length, has its cap
    if not report.accepted:
        raise ArchiveRefused(report)
    with services.snapshot() as session:
        phase = benchmarks.find_phase(session, order.benchmark, order.phase)
        request = (phase.id, admission.team_id, order.method, spooled.sha256)
        key = order.idempotency_key
        if key is not None and (known := submissions.replayed(session, admission.user_id, key, request)):
            return known.id
        # Asked before the bytes are promoted, so that a resumable upload can be completed later.
        _check_room_for_one(session, session.get_one(Team, admission.team_id), phase)
    services.blobs.put_file(spooled.path, spooled.sha256)
    submission_id = _record(services, admission, order, spooled)
    services.queue.enqueue(submission_id)
    return submission_id


def _check_room_for_one(session: Session, team: Team, phase: Phase) -> None:
    submissions.check_open(session, phase)
    quota.check(session, team=team, phase=phase)


def _record(services: Services, admission: Admission, order: Order, spooled: SpooledFile) -> uuid.UUID:
    try:
        with services.transaction() as session:
            submission = submissions.receive(
                session,
                phase=benchmarks.find_phase(session, order.benchmark, order.phase),
                team=session.get_one(Team, admission.team_id),
                user=session.get_one(User, admission.user_id),
                method_slug=order.method,
                shown=order.shown,
                predictions_sha256=spooled.sha256,
                size_bytes=spooled.size_bytes,
                file_name=order.file_name,
                actor=admission.actor,
                idempotency_key=order.idempotency_key,
            )
            return submission.id
    except sa.exc.IntegrityError as error:
        # Two uploads of one user for two teams under one key pass the teams' locks side by side.
        if order.idempotency_key is None:
            raise
        raise IdempotencyMismatch from error


def _team_of(session: Session, identity: Identity, slug: str | None) -> Team:
    """Find the team an upload is for: the token's, the one named, or the only one."""
    if identity.team is not None:
        if slug not in (None, identity.team.slug):
            raise Forbidden(f"this token acts for team {identity.team.slug}; use a token of team {slug}")
        return identity.team
    teams = accounts.teams_of(session, identity.user)
    chosen = [team for team in teams if slug in (None, team.slug)]
    if not chosen:
        raise Forbidden("you are not in that team; a maintainer can add you to one")
    if len(chosen) > 1:
        raise InvalidField("team: name one of " + ", ".join(team.slug for team in chosen))
    return chosen[0]
