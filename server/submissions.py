"""What teams do with submissions: send, look at, publish, withdraw, cancel; and maintainers' re-queue."""

import uuid
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session, joinedload, object_session

from server import audit, database, exclusions, integrity, lifecycle, quota
from server.accounts import checked_slug, checked_text, checked_url, is_member
from server.blobs import Blobs, record_blob
from server.errors import Forbidden, Held, IdempotencyMismatch, NotFound, NotScored, PhaseClosed
from server.models import Method, Phase, Publication, Score, Submission, SubmissionState, Team, User
from server.ranking import Basis, was_in_force


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What a team says of a method; what is empty is not said."""

    name: str = ""
    description: str = ""
    paper_url: str = ""
    code_url: str = ""


NOTHING_SAID = Shown()


def receive(
    session: Session,
    *,
    phase: Phase,
    team: Team,
    user: User,
    method_slug: str,
    predictions_sha256: str,
    size_bytes: int,
    file_name: str,
    actor: str,
    shown: Shown = NOTHING_SAID,
    idempotency_key: str | None = None,
) -> Submission:
    """Take a submission whose bytes are safe in the blob store; reserve one of the team's quota.

    A method that is new to the team is created, with its slug for a name where none is given. One that is known takes
    what is given and differs, so that nothing a sender says is dropped.
    After the commit, tell the queue: `queue.enqueue(submission.id)`.

    Raises:
        Forbidden: The user is not in the team.
        PhaseClosed: The phase takes no submissions now.
        QuotaExceeded: The team may not send more now.
        IdempotencyMismatch: The idempotency key was used for another request.
        InvalidField: A name or an address cannot be used.
    """
    if not is_member(session, team_id=team.id, user_id=user.id):
        message = f"{user.email} is not in team {team.slug}; ask a maintainer to add you"
        raise Forbidden(message)
    record_blob(session, _blobs_of(session), predictions_sha256, size_bytes)
    phase = _keep_rules(session, phase.id)
    quota.lock_team(session, team.id)
    request = (phase.id, team.id, method_slug, predictions_sha256)
    if idempotency_key and (known := replayed(session, user.id, idempotency_key, request)):
        return known
    check_open(session, phase)
    quota.check(session, team=team, phase=phase)
    at = database.now(session)
    submission = Submission(
        id=uuid.uuid4(),
        phase=phase,
        method=_described(session, _find_or_create_method(session, team, method_slug, actor), shown, actor),
        team=team,
        user=user,
        predictions_sha256=predictions_sha256,
        file_name=_shown_file_name(file_name),
        created_at=at,
        state_changed_at=at,
        enqueued_at=at,
        state=SubmissionState.RECEIVED,
        idempotency_key=idempotency_key,
    )
    session.add(submission)
    session.flush()
    quota.reserve(session, submission)
    audit.record(
        session,
        actor=actor,
        action="submission.received",
        subject=audit.subject_of(submission),
        phase=phase.id,
        team=team.id,
        sha256=predictions_sha256,
    )
    session.flush()
    return submission


def replayed(session: Session, user_id: int, key: str, request: tuple[int, int, str, str]) -> Submission | None:
    """Find the submission that a request with an idempotency key made before.

    Args:
        session: Reads the record.
        user_id: Who sends: keys are each user's own.
        key: Of the request.
        request: Phase, team, slug of the method, and digest of the predictions.

    Raises:
        IdempotencyMismatch: The user sent something else under this key.
    """
    known = sent_under(session, user_id, key)
    if known and (known.phase_id, known.team_id, known.method.slug, known.predictions_sha256) != request:
        raise IdempotencyMismatch
    return known


def sent_under(session: Session, user_id: int, key: str) -> Submission | None:
    """Find what a user sent under an idempotency key, whatever it is."""
    return session.scalar(sa.select(Submission).where(Submission.user_id == user_id, Submission.idempotency_key == key))


def check_open(session: Session, phase: Phase) -> None:
    """Refuse a phase that takes no submissions now; cheap enough to ask before an upload is read.

    Raises:
        PhaseClosed: It has no ground truth yet, has not begun or is over.
    """
    if why := why_closed(phase, database.now(session)):
        raise PhaseClosed(why)


def why_closed(phase: Phase, at: datetime) -> str | None:
    """Say why a phase takes no submissions at a time; None when it does."""
    if phase.ground_truth_id is None:
        return f"phase {phase.slug} takes no submissions yet: its ground truth is not imported"
    if phase.opens_at is not None and at < phase.opens_at:
        return f"phase {phase.slug} opens at {phase.opens_at:%Y-%m-%d %H:%M} UTC"
    if phase.closes_at is not None and at >= phase.closes_at:
        return f"phase {phase.slug} closed at {phase.closes_at:%Y-%m-%d %H:%M} UTC"
    return None


def _blobs_of(session: Session) -> Blobs:
    """Give the store that `Services.transaction` put beside the session."""
    blobs: Blobs = session.info["blobs"]
    return blobs


def _find_or_create_method(session: Session, team: Team, slug: str, actor: str) -> Method:
    slug = checked_slug("method", slug)
    found = session.scalar(sa.select(Method).where(Method.team_id == team.id, Method.slug == slug))
    if found:
        return found
    method = Method(team=team, slug=slug, name=slug, created_at=database.now(session))
    session.add(method)
    session.flush()
    audit.record(session, actor=actor, action="method.created", subject=audit.subject_of(method), slug=slug)
    return method


def _described(session: Session, method: Method, shown: Shown, actor: str) -> Method:
    """Let a method have what its team says of it; what is not said stays."""
    said = {
        "name": shown.name and checked_text("method_name", shown.name, max_length=200),
        "description": shown.description.strip(),
        "paper_url": shown.paper_url and checked_url("paper_url", shown.paper_url),
        "code_url": shown.code_url and checked_url("code_url", shown.code_url),
    }
    changed = {name: value for name, value in said.items() if value and value != getattr(method, name)}
    for name, value in changed.items():
        setattr(method, name, value)
    if changed:
        session.flush()
        audit.record(session, actor=actor, action="method.changed", subject=audit.subject_of(method), **changed)
    return method


def _shown_file_name(file_name: str) -> str:
    """Keep the last part of what the uploader called the file, printable and of bounded length."""
    name = file_name.replace("\\", "/").rsplit("/", 1)[-1]
    return "".join(character for character in name if character.isprintable())[:255] or "predictions.zip"


def find(session: Session, submission_id: uuid.UUID | str) -> Submission:
    """Find a submission with what its page shows.

    Raises:
        NotFound: There is none.
    """
    try:
        key = submission_id if isinstance(submission_id, uuid.UUID) else uuid.UUID(submission_id)
    except ValueError as error:
        raise NotFound(_unknown(submission_id)) from error
    query = (
        sa.select(Submission)
        .where(Submission.id == key)
        .options(
            joinedload(Submission.phase).joinedload(Phase.benchmark),
            joinedload(Submission.method),
            joinedload(Submission.team),
        )
    )
    submission = session.scalar(query)
    if submission is None:
        raise NotFound(_unknown(submission_id))
    return submission


def _unknown(submission_id: uuid.UUID | str) -> str:
    return f"there is no submission {str(submission_id)[:64]!r}"


def owned_by(submission: Submission, user: User | None) -> bool:
    """Say whether the user may act for the submission: a member of its team or a maintainer."""
    session = object_session(submission)
    return session is not None and acts_for(session, submission.team_id, user)


def acts_for(session: Session, team_id: int, user: User | None) -> bool:
    """Say whether the user may act for a team: a member of it or a maintainer."""
    return user is not None and (user.is_maintainer or is_member(session, team_id=team_id, user_id=user.id))


def visible_to(submission: Submission, user: User | None) -> bool:
    """Say whether the user may see the submission and its scores: everybody once it is published, else its owners."""
    return submission.publication is Publication.PUBLISHED or owned_by(submission, user)


def latest(
    session: Session, *conditions: sa.ColumnElement[bool], limit: int = 100, offset: int = 0
) -> list[Submission]:
    """List the submissions that meet all conditions, newest first, with what a list shows but their scores."""
    query = (
        sa.select(Submission)
        .where(*conditions)
        .options(
            joinedload(Submission.phase).joinedload(Phase.benchmark),
            joinedload(Submission.method),
            joinedload(Submission.team),
        )
        .order_by(Submission.created_at.desc(), Submission.id)
        .limit(limit)
        .offset(offset)
    )
    return list(session.scalars(query))


def publish(session: Session, submission: Submission, actor: str) -> None:
    """Show the submission as its method's row on the leaderboard, instead of the one shown until now.

    Raises:
        NotScored: It has no scores (yet), or none that rank, or a maintainer excluded it from ranking.
        Forbidden: The phase does not allow it.
        Held: A maintainer must release it first.
    """
    phase = _keep_rules(session, submission.phase_id)
    _lock(session, submission)
    if submission.state is not SubmissionState.SCORED:
        message = f"submission {submission.id} is {submission.state}; only a scored submission can be published"
        raise NotScored(message)
    if not submission.phase.allows_publication:
        message = f"phase {submission.phase.slug} has no leaderboard; its scores stay with their team"
        raise Forbidden(message)
    if submission.publication is Publication.PUBLISHED:
        return
    if excluded := exclusions.reason(session, submission):
        message = f"submission {submission.id} was not scored again on what ranks: {excluded}"
        raise NotScored(message)
    if not _ranks(session, submission, phase):
        message = (
            f"submission {submission.id} was scored on ground truth or by a protocol that does not rank any more; send"
            " the predictions again"
        )
        raise NotScored(message)
    if submission.held_reason is not None:
        message = f"a maintainer looks at this submission before it may be published: {submission.held_reason}"
        raise Held(message)
    # Two submissions of one method published at once queue up at the team's row, so that the later one wins.
    quota.lock_team(session, submission.team_id)
    shown = sa.select(Submission).where(
        Submission.phase_id == submission.phase_id,
        Submission.method_id == submission.method_id,
        Submission.publication == Publication.PUBLISHED,
    )
    for other in session.scalars(shown.with_for_update()):
        _set_publication(session, other, Publication.WITHDRAWN, actor, replaced_by=str(submission.id))
    submission.published_at = database.now(session)
    _set_publication(session, submission, Publication.PUBLISHED, actor)


def withdraw(session: Session, submission: Submission, actor: str) -> None:
    """Take a published submission off the leaderboard; nothing happens when it is not published."""
    _lock(session, submission)
    if submission.publication is Publication.PUBLISHED:
        _set_publication(session, submission, Publication.WITHDRAWN, actor)


def hold(session: Session, submission: Submission, *, reason: str, actor: str) -> None:
    """Take a submission off the leaderboard and keep it off until a maintainer releases it.

    Raises:
        InvalidField: No reason is given.
    """
    withdraw(session, submission, actor)
    integrity.hold(session, submission, checked_text("reason", reason, max_length=1000), actor=actor)


def _keep_rules(session: Session, phase_id: int) -> Phase:
    """Lock a phase so that its rules and what ranks in it stay what they are; others may do the same meanwhile."""
    return session.get_one(Phase, phase_id, with_for_update={"read": True}, populate_existing=True)


def _ranks(session: Session, submission: Submission, phase: Phase) -> bool:
    """Say whether the submission has a score by its phase's protocol on the ground truth in force.

    It has none when other ground truth was put in force since it was scored: published, it would be nowhere. What a
    re-scoring made does not count before it is published.
    """
    fitting = sa.select(Score.id).where(
        Score.submission_id == submission.id, Basis.of(phase).may_rank(), was_in_force()
    )
    return session.scalar(fitting.limit(1)) is not None


def _lock(session: Session, submission: Submission) -> None:
    """Lock the row and read it again."""
    query = sa.select(Submission).where(Submission.id == submission.id).with_for_update()
    session.scalar(query.execution_options(populate_existing=True))


def _set_publication(
    session: Session, submission: Submission, publication: Publication, actor: str, **detail: str
) -> None:
    submission.publication = publication
    submission.version += 1
    session.flush()
    action = f"publication.{publication}"
    audit.record(session, actor=actor, action=action, subject=audit.subject_of(submission), **detail)


def cancel(session: Session, submission: Submission, actor: str) -> None:
    """End a submission that is not being scored yet; it costs nothing.

    Raises:
        IllegalTransition: It is being scored or is done.
    """
    lifecycle.cancel(session, submission.id, actor=actor)


def requeue(session: Session, submission: Submission, actor: str) -> None:
    """Let a failed submission be tried again. After the commit, tell the queue.

    Raises:
        IllegalTransition: It has not failed.
    """
    lifecycle.requeue(session, submission.id, actor=actor)
