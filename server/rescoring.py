"""Re-scoring a phase: every scored submission again, beside what ranks, and then in force all at once.

A re-scoring prepares another basis (protocol, evaluator version, ground truth) for a phase. Each scored submission gets
one item (server/rescoring_items.py), also those that are scored while it runs. Until its publication the old basis ranks
and takes submissions; then one transaction changes the phase's row, so whoever reads a leaderboard sees the old ranking or
the new one, whole.

What maintainers decide about it is in server/rescoring_decisions.py. Locks are taken in the order that docs/architecture.md
names: phase, re-scoring, items, submissions.
"""

import uuid
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.protocol import EVALUATOR_VERSION, PROTOCOLS
from server import audit, database, exclusions
from server.errors import Conflict, InvalidField, NotFound
from server.models import (
    GroundTruthVersion,
    ItemState,
    Phase,
    Rescoring,
    RescoringItem,
    RescoringState,
    Score,
    Submission,
    SubmissionState,
)
from server.ranking import Basis
from server.rescoring_items import DONE, EXCLUDED, FAILED, WAITING


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """How far a re-scoring is."""

    counts: dict[ItemState, int]
    failures: tuple[RescoringItem, ...]
    uncovered: int
    """Scored submissions that have no item yet; the sweeper adds them."""

    @property
    def total(self) -> int:
        """Count the submissions it is about."""
        return sum(self.counts.values()) + self.uncovered

    @property
    def settled(self) -> int:
        """Count those that have their score or are excluded."""
        return self.counts[DONE] + self.counts[EXCLUDED]

    @property
    def complete(self) -> bool:
        """Say whether it can be published."""
        return self.settled == self.total


def start(
    session: Session, *, phase: Phase, actor: str, version: int | None = None, protocol: str | None = None
) -> Rescoring:
    """Begin to score a phase's submissions again. After the commit, send what is `waiting`.

    Args:
        session: Of the transaction.
        phase: The phase.
        actor: Who begins it, for the audit trail.
        version: Of the ground truth, imported before; by default the one in force.
        protocol: By default the one in force.

    Raises:
        NotFound: There is no such version.
        InvalidField: There is no such protocol.
        Conflict: The phase has no ground truth or is being scored again already, or there is nothing to score.
    """
    lock_phase(session, phase)
    if find_running(session, phase) is not None:
        message = f"phase {phase.slug} is being scored again already; publish or discard that first"
        raise Conflict(message)
    if protocol is not None and protocol not in PROTOCOLS:
        message = f"there is no protocol {protocol!r}; choose one of {', '.join(PROTOCOLS)}"
        raise InvalidField(message)
    rescoring = Rescoring(
        phase_id=phase.id,
        ground_truth_id=_ground_truth(session, phase, version).id,
        protocol=protocol or phase.protocol,
        evaluator_version=EVALUATOR_VERSION,
        created_at=database.now(session),
    )
    session.add(rescoring)
    session.flush()
    cover(session, rescoring)
    basis = Basis.of(rescoring)
    if basis == Basis.of(phase) and _all_done(session, rescoring):
        message = (
            "every submission has its score by this protocol and evaluator on this ground truth; nothing was begun"
        )
        raise Conflict(message)
    record(session, rescoring, "started", actor, basis=describe(session, basis))
    return rescoring


def lock_phase(session: Session, phase: Phase) -> None:
    """Let nobody else change what is in force, and let no score be written that counts on it, until the end."""
    query = sa.select(Phase).where(Phase.id == phase.id).with_for_update(key_share=True)
    session.scalar(query.execution_options(populate_existing=True))


def _ground_truth(session: Session, phase: Phase, version: int | None) -> GroundTruthVersion:
    if version is None:
        if phase.ground_truth is None:
            message = f"phase {phase.slug} has no ground truth yet; import it with `cs3d-admin import-ground-truth`"
            raise Conflict(message)
        return phase.ground_truth
    found = session.scalar(
        sa.select(GroundTruthVersion).where(
            GroundTruthVersion.phase_id == phase.id, GroundTruthVersion.version == version
        )
    )
    if found is None:
        message = f"phase {phase.slug} has no version {version} of ground truth; import it first"
        raise NotFound(message)
    return found


def find_running(session: Session, phase: Phase) -> Rescoring | None:
    """Find the re-scoring of a phase that has not ended."""
    return session.scalar(
        sa.select(Rescoring).where(Rescoring.phase_id == phase.id, Rescoring.state == RescoringState.RUNNING)
    )


def get_running(session: Session, phase: Phase) -> Rescoring:
    """Find the re-scoring of a phase that has not ended.

    Raises:
        NotFound: There is none.
    """
    rescoring = find_running(session, phase)
    if rescoring is None:
        message = f"phase {phase.slug} is not being scored again; begin with `cs3d-admin rescore start`"
        raise NotFound(message)
    return rescoring


def uncovered(session: Session, rescoring: Rescoring) -> list[uuid.UUID]:
    """List the scored submissions of the phase that have no item yet, oldest first."""
    has_item = sa.exists().where(
        RescoringItem.rescoring_id == rescoring.id, RescoringItem.submission_id == Submission.id
    )
    query = sa.select(Submission.id).where(
        Submission.phase_id == rescoring.phase_id, Submission.state == SubmissionState.SCORED, ~has_item
    )
    return list(session.scalars(query.order_by(Submission.created_at, Submission.id)))


def cover(session: Session, rescoring: Rescoring, *, sent: bool = True) -> list[int]:
    """Add an item for every scored submission without one.

    What is excluded on the ground truth stays so until a maintainer takes it back, whatever scores it has; what has its
    score on the new basis already is done.

    Args:
        session: Of the transaction.
        rescoring: Nothing happens when it has ended.
        sent: The caller sends the items after the commit; False leaves that to the sweeper.

    Returns:
        The new items that wait for a worker.
    """
    still_running = sa.select(Rescoring.id).where(
        Rescoring.id == rescoring.id, Rescoring.state == RescoringState.RUNNING
    )
    missing = uncovered(session, rescoring) if session.scalar(still_running.with_for_update()) else []
    fitting = sa.select(Score.submission_id, sa.func.max(Score.id)).where(
        Basis.of(rescoring).fits(), Score.submission_id.in_(missing)
    )
    known = dict(session.execute(fitting.group_by(Score.submission_id)).all()) if missing else {}
    enqueued_at = database.now(session) if sent else None
    excluded = exclusions.reasons(session, rescoring.ground_truth_id, missing)
    items = [_item(rescoring, one, known.get(one), excluded.get(one)) for one in missing]
    for item in items:
        item.enqueued_at = enqueued_at
    session.add_all(items)
    session.flush()
    return [item.id for item in items if item.state is WAITING]


def _item(
    rescoring: Rescoring, submission_id: uuid.UUID, score_id: int | None, exclusion_reason: str | None
) -> RescoringItem:
    item = RescoringItem(rescoring_id=rescoring.id, submission_id=submission_id, state=WAITING)
    if exclusion_reason is not None:
        item.state, item.exclusion_reason = EXCLUDED, exclusion_reason
    elif score_id is not None:
        item.state, item.score_id = DONE, score_id
    return item


def waiting(session: Session, rescoring: Rescoring) -> list[int]:
    """List the items that wait for a worker, oldest first."""
    query = sa.select(RescoringItem.id).where(
        RescoringItem.rescoring_id == rescoring.id, RescoringItem.state == WAITING
    )
    return list(session.scalars(query.order_by(RescoringItem.id)))


def _all_done(session: Session, rescoring: Rescoring) -> bool:
    """Say whether there is nothing to do: what is excluded may be taken back, which takes a re-scoring."""
    others = sa.exists().where(RescoringItem.rescoring_id == rescoring.id, RescoringItem.state != DONE)
    return not session.scalar(sa.select(others))


def progress(session: Session, rescoring: Rescoring) -> Progress:
    """Count a re-scoring's items by state, and name those that failed with their cause."""
    own = RescoringItem.rescoring_id == rescoring.id
    counted = sa.select(RescoringItem.state, sa.func.count()).where(own).group_by(RescoringItem.state)
    counts = dict(session.execute(counted).all())
    failures = session.scalars(sa.select(RescoringItem).where(own, RescoringItem.state == FAILED))
    return Progress(
        counts={state: counts.get(state, 0) for state in ItemState},
        failures=tuple(failures),
        uncovered=len(uncovered(session, rescoring)),
    )


def describe(session: Session, basis: Basis) -> dict[str, Any]:
    """Write a basis down for the audit trail and for people."""
    version = session.get(GroundTruthVersion, basis.ground_truth_id)
    return {
        "protocol": basis.protocol,
        "evaluator_version": basis.evaluator_version,
        "ground_truth_version": version.version if version else None,
        "ground_truth_sha256": version.sha256 if version else None,
    }


def record(session: Session, rescoring: Rescoring, what: str, actor: str, **detail: Any) -> None:  # noqa: ANN401 - JSON
    """Write an audit event of the phase."""
    audit.record(
        session,
        actor=actor,
        action=f"rescoring.{what}",
        subject=f"phase:{rescoring.phase_id}",
        rescoring=rescoring.id,
        **detail,
    )
