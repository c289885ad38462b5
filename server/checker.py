"""An independent checker of everything the record promises, for maintainers (`cs3d-admin check`) and tests.

It trusts nothing: rows are held against blobs, states against the audit trail, the ledger against the states, and
scores against scores computed again. It only reads. What it finds is never repaired here.
"""

import itertools
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.evaluation import evaluate
from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.intake import read_predictions
from evaluator.limits import ANY_SIZE
from evaluator.protocol import EVALUATOR_VERSION, PROTOCOLS
from evaluator.results import Scores
from server import database, quota, ranking, rescoring_checks
from server.blobs import digest_file, known_digests
from server.errors import NotFound
from server.lifecycle import TRANSITIONS
from server.models import (
    Attempt,
    AttemptOutcome,
    AuditEvent,
    Blob,
    GroundTruthVersion,
    Phase,
    Publication,
    QuotaEntry,
    QuotaKind,
    Score,
    Shard,
    Submission,
    SubmissionState,
)
from server.rescoring_checks import made_again
from server.services import Services


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """One promise that does not hold."""

    rule: str
    """Which promise: the name of the rule below."""
    subject: str
    """What breaks it, for example `submission:<id>`."""
    detail: str


Found = Iterator[tuple[str, str]]
"""Subject and detail."""


def check(services: Services, recompute: bool = True) -> list[Violation]:  # noqa: FBT001, FBT002 - a public signature
    """Check every promise.

    Args:
        services: The installation; it may be at work meanwhile.
        recompute: Also read every blob and compute every score and prepared ground truth again.

    Returns:
        What does not hold; empty when all is well.
    """
    rules = [*CHEAP_RULES, *(THOROUGH_RULES if recompute else ())]
    with services.snapshot() as session:
        if session.connection().dialect.name == "postgresql":  # computing between two queries takes its time
            session.execute(sa.text("SET LOCAL idle_in_transaction_session_timeout = 0"))
        return [
            Violation(rule=rule.__name__, subject=subject, detail=detail)
            for rule in rules
            for subject, detail in rule(services, session)
        ]


def every_row_has_its_blob(services: Services, session: Session) -> Found:
    """A row never points to bytes that are missing or of another size."""
    stored = {blob.sha256: blob.size_bytes for blob in services.blobs.stored()}
    for blob in session.scalars(sa.select(Blob)):
        if blob.sha256 not in stored:
            yield f"blob:{blob.sha256}", "is not in the blob store"
        elif stored[blob.sha256] != blob.size_bytes:
            yield f"blob:{blob.sha256}", f"has {stored[blob.sha256]} bytes in the store, {blob.size_bytes} in the row"


def every_old_blob_has_its_row(services: Services, session: Session) -> Found:
    """Bytes without a row are swept after the grace time and two passes of the sweeper."""
    known = known_digests(session)
    grace = timedelta(seconds=services.settings.orphan_grace_s * 2 + 1)
    deadline = database.now(session) - grace
    for blob in services.blobs.stored():
        if blob.sha256 not in known and blob.modified_at < deadline:
            yield f"blob:{blob.sha256}", "is in the store, but no row knows it"


def states_follow_the_trail(services: Services, session: Session) -> Found:
    """The audit trail of every submission is a legal path that ends in its state."""
    del services
    trails = _trails(session)
    legal = {(source.value, target.value) for source, targets in TRANSITIONS.items() for target in targets}
    for submission in session.scalars(sa.select(Submission)):
        subject = f"submission:{submission.id}"
        trail = [state for state, _ in trails.pop(subject, [])]
        if trail[:1] != ["received"] or trail[-1] != submission.state:
            yield subject, f"is {submission.state}, its trail says {trail}"
        elif not legal.issuperset(itertools.pairwise(trail)):
            yield subject, f"its trail makes an illegal step: {trail}"
    for subject in trails:
        yield subject, "has a trail but no row"


def the_trail_has_every_step(services: Services, session: Session) -> Found:
    """Each step starts where the one before it ended; every attempt since the first valid one began scoring once."""
    del services
    trails = _trails(session)
    for submission in session.scalars(sa.select(Submission)):
        subject = f"submission:{submission.id}"
        trail = trails[subject]
        sources = [detail.get("source") for _, detail in trail[1:]]
        if sources != [state for state, _ in trail[:-1]]:
            yield subject, f"its steps {[state for state, _ in trail]} say that they started from {sources}"
        began = [detail["attempt"] for state, detail in trail if state == SubmissionState.SCORING]
        if began and began != list(range(began[0], submission.attempt + 1)):
            yield subject, f"attempts {began} of {submission.attempt} began scoring"


def _trails(session: Session) -> defaultdict[str, list[tuple[str, dict[str, Any]]]]:
    """Read every state that a submission came into, oldest first, with the detail of that event."""
    trails: defaultdict[str, list[tuple[str, dict[str, Any]]]] = defaultdict(list)
    changes = [f"submission.{state}" for state in SubmissionState]
    for event in session.scalars(sa.select(AuditEvent).where(AuditEvent.action.in_(changes)).order_by(AuditEvent.id)):
        trails[event.subject].append((event.action.removeprefix("submission."), event.detail))
    return trails


def attempts_add_up(services: Services, session: Session) -> Found:
    """Attempts are numbered without gaps; only the latest may run, exactly while the lease is held."""
    del services
    attempts: dict[object, list[Attempt]] = defaultdict(list)
    for attempt in session.scalars(sa.select(Attempt).order_by(Attempt.number)):
        attempts[attempt.submission_id].append(attempt)
    for submission in session.scalars(sa.select(Submission)):
        own = attempts[submission.id]
        subject = f"submission:{submission.id}"
        if [attempt.number for attempt in own] != list(range(1, submission.attempt + 1)):
            yield subject, f"has attempt {submission.attempt}, but rows for {[a.number for a in own]}"
        running = [attempt.number for attempt in own if attempt.outcome is AttemptOutcome.RUNNING]
        if running != ([submission.attempt] if submission.lease_expires_at else []):
            yield subject, f"attempts {running} run, its lease is {submission.lease_expires_at}"
        scored = [attempt.number for attempt in own if attempt.outcome is AttemptOutcome.SCORED]
        if len(scored) != (submission.state is SubmissionState.SCORED):
            yield subject, f"is {submission.state}, but attempts {scored} scored it"


def shards_are_of_running_attempts(services: Services, session: Session) -> Found:
    """Shards are there only while their attempt runs; together they have every image once, and each blob is kept."""
    stored = {blob.sha256 for blob in services.blobs.stored()}
    shards: dict[Attempt, list[Shard]] = defaultdict(list)
    for shard in session.scalars(sa.select(Shard).order_by(Shard.number)):
        attempt = session.get_one(Attempt, (shard.submission_id, shard.attempt))
        shards[attempt].append(shard)
        for sha256 in {shard.predictions_sha256, shard.result_sha256} - stored - {None}:
            yield f"blob:{sha256}", f"is not in the blob store, but shard {shard.number} of {attempt.number} keeps it"
    for attempt, own in shards.items():
        subject = f"submission:{attempt.submission_id}"
        if attempt.outcome is not AttemptOutcome.RUNNING:
            yield subject, f"attempt {attempt.number} is {attempt.outcome} and has {len(own)} shards"
        if own[0].first_image or any(one.end_image != two.first_image for one, two in itertools.pairwise(own)):
            yield subject, f"the shards of attempt {attempt.number} do not follow one another"


def scores_belong_to_scored(services: Services, session: Session) -> Found:
    """A submission has scores exactly when it is scored, each on its phase's ground truth, by an attempt that scored."""
    del services
    again = made_again(session)
    scored_attempts = {
        (row.submission_id, row.number)
        for row in session.scalars(sa.select(Attempt).where(Attempt.outcome == AttemptOutcome.SCORED))
    }
    counts: Counter[object] = Counter()
    for score in session.scalars(sa.select(Score)):
        counts[score.submission_id] += 1
        subject = f"score:{score.id}"
        if score.id not in again and (score.submission_id, score.attempt) not in scored_attempts:
            yield subject, f"comes from attempt {score.attempt}, which did not score"
        if score.ground_truth.phase_id != score.submission.phase_id:
            yield subject, "is on another phase's ground truth"
    for submission in session.scalars(sa.select(Submission)):
        if (counts[submission.id] > 0) != (submission.state is SubmissionState.SCORED):
            yield f"submission:{submission.id}", f"is {submission.state} and has {counts[submission.id]} scores"


def no_score_is_written_twice(services: Services, session: Session) -> Found:
    """There is one score for each submission, protocol, evaluator version and ground truth."""
    del services
    signature = (
        Score.submission_id, Score.protocol, Score.protocol_version, Score.evaluator_version, Score.ground_truth_id
    )  # fmt: skip
    query = sa.select(Score.submission_id, sa.func.count()).group_by(*signature).having(sa.func.count() > 1)
    for submission_id, count in session.execute(query):
        yield f"submission:{submission_id}", f"has {count} scores of one signature"


def the_ledger_fits_the_states(services: Services, session: Session) -> Found:
    """One reservation each; a charge exactly when scored; a refund exactly when it cost nothing, once."""
    del services
    kinds: dict[object, Counter[QuotaKind]] = defaultdict(Counter)
    for entry in session.scalars(sa.select(QuotaEntry).where(QuotaEntry.submission_id.is_not(None))):
        kinds[entry.submission_id][entry.kind] += 1
    failed_once = set(session.scalars(sa.select(AuditEvent.subject).where(AuditEvent.action == "submission.failed")))
    free = {SubmissionState.REJECTED, SubmissionState.FAILED, SubmissionState.CANCELLED}
    for submission in session.scalars(sa.select(Submission)):
        subject = f"submission:{submission.id}"
        due = {
            QuotaKind.RESERVE: 1,
            QuotaKind.CHARGE: int(submission.state is SubmissionState.SCORED),
            QuotaKind.REFUND: int(submission.state in free or subject in failed_once),
        }
        for kind, count in due.items():
            if kinds[submission.id][kind] != count:
                yield subject, f"is {submission.state} and has {kinds[submission.id][kind]} entries {kind}, not {count}"


def no_quota_was_overrun(services: Services, session: Session) -> Found:
    """No team has more than its quota at once, at any of its submissions since the phase's rules were last set."""
    del services
    for phase in session.scalars(sa.select(Phase)):
        rules_set_at = session.scalar(
            sa.select(sa.func.max(AuditEvent.at)).where(
                AuditEvent.subject == f"phase:{phase.id}", AuditEvent.action.in_(("phase.created", "phase.changed"))
            )
        )
        entries: dict[int, list[QuotaEntry]] = defaultdict(list)
        for entry in session.scalars(
            sa.select(QuotaEntry).where(QuotaEntry.phase_id == phase.id).order_by(QuotaEntry.id)
        ):
            entries[entry.team_id].append(entry)
        for team_id, own in entries.items():
            for entry in own:
                if entry.kind is QuotaKind.RESERVE and (rules_set_at is None or entry.created_at >= rules_set_at):
                    count = _count_at(own, entry)
                    if count > phase.submissions_per_day:
                        yield f"team:{team_id}", f"had {count} of {phase.submissions_per_day} at entry {entry.id}"


def _count_at(entries: list[QuotaEntry], last: QuotaEntry) -> int:
    """Count what a team had in the window that ends with `last`, as the ledger stood then."""
    then = [entry for entry in entries if entry.id <= last.id]
    refunded = {entry.submission_id for entry in then if entry.kind is QuotaKind.REFUND}
    window = [entry for entry in then if entry.created_at > last.created_at - quota.WINDOW]
    reserved = sum(e.kind is QuotaKind.RESERVE and e.submission_id not in refunded for e in window)
    return reserved + sum(e.amount for e in window if e.kind is QuotaKind.GRANT)


def owners_match(services: Services, session: Session) -> Found:
    """A submission's method is its team's, and a phase's ground truth is its own."""
    del services
    for submission in session.scalars(sa.select(Submission)):
        if submission.method.team_id != submission.team_id:
            yield f"submission:{submission.id}", "is of another team than its method"
    for phase in session.scalars(sa.select(Phase)):
        if phase.ground_truth is not None and phase.ground_truth.phase_id != phase.id:
            yield f"phase:{phase.id}", "is scored on another phase's ground truth"


def leaderboards_are_sorted(services: Services, session: Session) -> Found:
    """Every published submission has its row; ranks are one more than the number of methods that are better."""
    del services
    for phase in session.scalars(sa.select(Phase)):
        rows = ranking.leaderboard(session, phase).rows
        published = session.scalars(
            sa.select(Submission.id).where(
                Submission.phase_id == phase.id, Submission.publication == Publication.PUBLISHED
            )
        )
        if Counter(row.submission.id for row in rows) != Counter(published):
            yield f"phase:{phase.id}", "its leaderboard does not show exactly the published submissions"
        values = [row.mds for row in rows if row.mds is not None]
        for row in rows:
            due = None if row.mds is None else 1 + sum(value > row.mds for value in values)
            if row.rank != due:
                yield f"submission:{row.submission.id}", f"has rank {row.rank} instead of {due}"


def every_blob_is_what_its_name_says(services: Services, session: Session) -> Found:
    """The digest of every blob, read again, is its name."""
    for sha256 in session.scalars(sa.select(Blob.sha256)):
        try:
            actual = digest_file(services.blobs.local_path(sha256))
        except NotFound:
            continue  # told by `every_row_has_its_blob`
        if actual != sha256:
            yield f"blob:{sha256}", f"holds bytes with digest {actual}"


def prepared_ground_truth_equals_its_source(services: Services, session: Session) -> Found:
    """Preparing the imported files again gives the same bytes."""
    for version in session.scalars(sa.select(GroundTruthVersion)):
        subject = f"ground_truth:{version.id}"
        try:
            with tempfile.TemporaryDirectory() as folder:
                source = Path(folder) / "source.zip"
                source.write_bytes(services.blobs.read(version.source_sha256))
                prepared = read_ground_truth(source).to_bytes()
            if prepared != services.blobs.read(version.sha256):
                yield subject, "its files give other prepared bytes now"
        except NotFound as error:
            yield subject, str(error)


def scores_are_reproducible(services: Services, session: Session) -> Found:
    """Scores in the row, in the blob and computed again from prediction and ground truth are equal in every digit."""
    for score in session.scalars(sa.select(Score).order_by(Score.id)):
        try:
            detail = _difference(services, score)
        except NotFound as error:
            detail = str(error)
        if detail:
            yield f"score:{score.id}", detail


def _difference(services: Services, score: Score) -> str | None:
    kept = msgspec.json.decode(services.blobs.read(score.scores_sha256), type=Scores)
    if kept.mds != score.mds or ranking.summary_of(kept) != score.summary:
        return "the row shows other numbers than the kept scores"
    if (kept.signature.predictions_sha256, kept.signature.ground_truth_sha256) != (
        score.submission.predictions_sha256,
        score.ground_truth.sha256,
    ):
        return "the kept scores are signed for other predictions or ground truth"
    if score.evaluator_version != EVALUATOR_VERSION:
        return None  # another version's number; it is kept, not reproduced
    return None if _computed_again(services, score) == kept else "computing it again gives other numbers"


def _computed_again(services: Services, score: Score) -> Scores | None:
    """Score the submission from its blobs; None when its predictions are refused now."""
    ground_truth = GroundTruth.from_bytes(services.blobs.read(score.ground_truth.sha256))
    predictions_sha256 = score.submission.predictions_sha256
    path = services.blobs.local_path(predictions_sha256)
    intake = read_predictions(path, images=ground_truth.image_list(), limits=ANY_SIZE)
    if intake.predictions is None:
        return None
    return evaluate(
        ground_truth,
        intake.predictions,
        PROTOCOLS[score.protocol],
        ground_truth_sha256=score.ground_truth.sha256,
        predictions_sha256=predictions_sha256,
    ).scores


CHEAP_RULES: tuple[Callable[[Services, Session], Found], ...] = (
    every_row_has_its_blob,
    every_old_blob_has_its_row,
    states_follow_the_trail,
    the_trail_has_every_step,
    attempts_add_up,
    shards_are_of_running_attempts,
    scores_belong_to_scored,
    no_score_is_written_twice,
    the_ledger_fits_the_states,
    no_quota_was_overrun,
    owners_match,
    leaderboards_are_sorted,
    *rescoring_checks.RULES,
)
"""Rows, the list of blobs and nothing else."""

THOROUGH_RULES: tuple[Callable[[Services, Session], Found], ...] = (
    every_blob_is_what_its_name_says,
    prepared_ground_truth_equals_its_source,
    scores_are_reproducible,
)
"""Everything is read and computed again."""
