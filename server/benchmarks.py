"""Benchmarks, their phases and the versions of their hidden ground truth."""

import io
import zipfile
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Unpack

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session, joinedload

from evaluator.ground_truth import ground_truth_files, read_ground_truth
from evaluator.protocol import CITYSCAPES3D, PROTOCOLS
from server import audit, database
from server.accounts import checked_slug, checked_text
from server.blobs import Blobs, record_blob
from server.errors import Conflict, InvalidField, NotFound
from server.models import (
    Benchmark,
    GroundTruthVersion,
    Phase,
    Publication,
    Rescoring,
    RescoringState,
    Score,
    Submission,
    SubmissionState,
)
from server.phase_rules import PhaseRules, checked_rules, rules_of, written_rules

ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The time every member of a canonical zip carries, so that equal files give equal bytes."""

MOST_SHARDS = 64
"""More would each be too small to be worth a message; a constraint of the table holds the same number."""


def create_benchmark(session: Session, *, slug: str, title: str, description: str = "", actor: str) -> Benchmark:
    """Create a benchmark without phases.

    Raises:
        Conflict: The slug is taken.
    """
    slug = checked_slug("benchmark", slug)
    if session.scalar(sa.select(Benchmark.id).where(Benchmark.slug == slug)):
        message = f"there is a benchmark {slug!r}; choose another name"
        raise Conflict(message)
    benchmark = Benchmark(
        slug=slug,
        title=checked_text("title", title, max_length=200),
        description=description,
        created_at=database.now(session),
    )
    session.add(benchmark)
    session.flush()
    audit.record(session, actor=actor, action="benchmark.created", subject=audit.subject_of(benchmark), slug=slug)
    return benchmark


def create_phase(
    session: Session,
    *,
    benchmark: Benchmark,
    slug: str,
    title: str,
    actor: str,
    protocol: str = CITYSCAPES3D.name,
    is_open: bool = False,
    allows_publication: bool = True,
    opens_at: datetime | None = None,
    closes_at: datetime | None = None,
    submissions_per_day: int = 10,
    rejections_per_day: int = 50,
    max_attempts: int = 3,
    shards: int = 1,
) -> Phase:
    """Create a phase; it takes submissions once it has ground truth.

    Raises:
        Conflict: The benchmark has a phase of this name.
        InvalidField: There is no such protocol, a number is out of range, or the phase would close before it opens.
    """
    slug = checked_slug("phase", slug)
    if session.scalar(sa.select(Phase.id).where(Phase.benchmark_id == benchmark.id, Phase.slug == slug)):
        message = f"benchmark {benchmark.slug} has a phase {slug!r}; choose another name"
        raise Conflict(message)
    if protocol not in PROTOCOLS:
        message = f"there is no protocol {protocol!r}; choose one of {', '.join(PROTOCOLS)}"
        raise InvalidField(message)
    rules = checked_rules(
        PhaseRules(
            title=title,
            is_open=is_open,
            allows_publication=allows_publication,
            opens_at=opens_at,
            closes_at=closes_at,
            submissions_per_day=submissions_per_day,
            rejections_per_day=rejections_per_day,
            max_attempts=max_attempts,
        )
    )
    phase = Phase(
        benchmark=benchmark,
        slug=slug,
        protocol=protocol,
        shards=checked_shards(shards),
        created_at=database.now(session),
        **rules,
    )
    session.add(phase)
    session.flush()
    audit.record(session, actor=actor, action="phase.created", subject=audit.subject_of(phase), slug=slug)
    return phase


def edit_phase(session: Session, phase: Phase, *, actor: str, **changes: Unpack[PhaseRules]) -> dict[str, object]:
    """Change rules of a phase from now on.

    Returns:
        The new values, as JSON, of the rules that differ from what they were; empty: none does, and nothing happens.

    Raises:
        InvalidField: A value cannot be, alone or beside the rules that stay.
        Conflict: Submissions are published in a phase that shall not allow it any more.
    """
    session.get_one(Phase, phase.id, with_for_update={"key_share": True}, populate_existing=True)
    before = rules_of(phase)
    rules = checked_rules({**before, **changes})
    old, new = written_rules(before), written_rules(rules)
    changed = [name for name in new if new[name] != old[name]]
    if not changed:
        return {}
    if "allows_publication" in changed and not rules["allows_publication"]:
        _require_nothing_published(session, phase)
    for name, value in rules.items():
        setattr(phase, name, value)
    session.flush()
    detail = {"old": {name: old[name] for name in changed}, "new": {name: new[name] for name in changed}}
    audit.record(session, actor=actor, action="phase.changed", subject=audit.subject_of(phase), **detail)
    return detail["new"]


def _require_nothing_published(session: Session, phase: Phase) -> None:
    published = sa.select(sa.func.count()).where(
        Submission.phase_id == phase.id, Submission.publication == Publication.PUBLISHED
    )
    if count := session.scalar(published):
        message = (
            f"phase {phase.slug} has {count} published; take them off its leaderboard with"
            " `cs3d-admin publish --withdraw`, then forbid publication"
        )
        raise Conflict(message)


def set_shards(session: Session, phase: Phase, shards: int, *, actor: str) -> None:
    """Choose into how many ranges of images the submissions of a phase are divided from their next claim on.

    Raises:
        InvalidField: The number is out of range.
    """
    phase.shards = checked_shards(shards)
    session.flush()
    audit.record(session, actor=actor, action="phase.shards_set", subject=audit.subject_of(phase), shards=shards)


def checked_shards(shards: int) -> int:
    """Give the number of shards back when a phase may have it."""
    if not 1 <= shards <= MOST_SHARDS:
        message = f"shards must be from 1 (submissions are scored in one piece) to {MOST_SHARDS}"
        raise InvalidField(message)
    return shards


def find_benchmark(session: Session, slug: str) -> Benchmark:
    """Find a benchmark with its phases.

    Raises:
        NotFound: There is none.
    """
    phases = joinedload(Benchmark.phases).joinedload(Phase.ground_truth)
    query = sa.select(Benchmark).where(Benchmark.slug == slug).options(phases)
    benchmark = session.scalars(query).unique().one_or_none()
    if benchmark is None:
        message = f"there is no benchmark {slug[:80]!r}; `GET /api/v1/benchmarks` lists them"
        raise NotFound(message)
    return benchmark


def list_benchmarks(session: Session) -> list[Benchmark]:
    """List every benchmark with its phases, oldest first."""
    phases = joinedload(Benchmark.phases).joinedload(Phase.ground_truth)
    query = sa.select(Benchmark).options(phases).order_by(Benchmark.id)
    return list(session.scalars(query).unique())


def find_phase(session: Session, benchmark_slug: str, phase_slug: str) -> Phase:
    """Find a phase with its benchmark and the ground truth in force.

    Raises:
        NotFound: There is none.
    """
    query = (
        sa.select(Phase)
        .join(Phase.benchmark)
        .where(Benchmark.slug == benchmark_slug, Phase.slug == phase_slug)
        .options(joinedload(Phase.benchmark), joinedload(Phase.ground_truth))
    )
    phase = session.scalars(query).one_or_none()
    if phase is None:
        message = f"there is no phase {phase_slug[:80]!r} in benchmark {benchmark_slug[:80]!r}"
        raise NotFound(message)
    return phase


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedGroundTruth:
    """Ground truth whose bytes are in the store; no row knows it yet."""

    sha256: str
    source_sha256: str
    image_list_sha256: str
    sizes_bytes: dict[str, int]
    """Of each of the three, by digest."""
    image_count: int
    box_count: int


def prepare_ground_truth(blobs: Blobs, source: Path) -> PreparedGroundTruth:
    """Read and validate ground truth and keep its bytes. It may take minutes: do it outside of any transaction.

    Args:
        blobs: Where its bytes are kept; what is not added to a phase is swept after the grace time.
        source: A folder or zip of `*_gtBbox3d.json`.

    Raises:
        GroundTruthError: It cannot be used; every problem is listed.
    """
    ground_truth = read_ground_truth(source)
    parts = {
        "sha256": ground_truth.to_bytes(),
        "source_sha256": canonical_zip(source),
        "image_list_sha256": msgspec.json.encode(ground_truth.image_list()),
    }
    digests = {name: blobs.put_bytes(data) for name, data in parts.items()}
    return PreparedGroundTruth(
        **digests,
        sizes_bytes={digests[name]: len(data) for name, data in parts.items()},
        image_count=len(ground_truth.images),
        box_count=len(ground_truth),
    )


def add_ground_truth(
    session: Session,
    blobs: Blobs,
    *,
    phase: Phase,
    prepared: PreparedGroundTruth,
    actor: str,
    imported_by: int | None = None,
) -> GroundTruthVersion:
    """Add prepared ground truth to a phase as its next version, not in force.

    Args:
        session: Of the transaction.
        blobs: Where its bytes are.
        phase: The phase it belongs to.
        prepared: By `prepare_ground_truth`.
        actor: Who imports it, for the audit trail.
        imported_by: The user's id, where one is known.

    Raises:
        Conflict: The version in force is the same.
    """
    if phase.ground_truth is not None and phase.ground_truth.sha256 == prepared.sha256:
        message = f"this is version {phase.ground_truth.version}, which is in force already; nothing was imported"
        raise Conflict(message)
    for sha256, size_bytes in prepared.sizes_bytes.items():
        record_blob(session, blobs, sha256, size_bytes)
    _lock(session, phase)  # so that two imports at once get two numbers
    latest = session.scalar(
        sa.select(sa.func.max(GroundTruthVersion.version)).where(GroundTruthVersion.phase_id == phase.id)
    )
    version = GroundTruthVersion(
        phase_id=phase.id,
        version=(latest or 0) + 1,
        sha256=prepared.sha256,
        source_sha256=prepared.source_sha256,
        image_list_sha256=prepared.image_list_sha256,
        image_count=prepared.image_count,
        box_count=prepared.box_count,
        imported_by=imported_by,
        created_at=database.now(session),
    )
    session.add(version)
    session.flush()
    audit.record(
        session,
        actor=actor,
        action="ground_truth.imported",
        subject=audit.subject_of(phase),
        version=version.version,
        sha256=version.sha256,
    )
    return version


def enforce_if_possible(session: Session, phase: Phase, version: GroundTruthVersion, *, actor: str) -> bool:
    """Let a version rank at once where nothing is published in the phase; otherwise a re-scoring does.

    Returns:
        True when it is in force.
    """
    # The first locks the phase, so no re-scoring of it begins after the second has looked.
    possible = not _published_without_score(session, phase, version) and not _is_rescored(session, phase)
    if possible:
        enforce_ground_truth(session, phase, version, actor=actor)
    return possible


def import_ground_truth(
    session: Session, blobs: Blobs, *, phase: Phase, source: Path, actor: str
) -> GroundTruthVersion:
    """Prepare ground truth, add it and let it rank if possible, all in one transaction: for phases being set up.

    Raises:
        GroundTruthError: It cannot be used; every problem is listed.
        Conflict: The version in force is the same.
    """
    prepared = prepare_ground_truth(blobs, source)
    version = add_ground_truth(session, blobs, phase=phase, prepared=prepared, actor=actor)
    enforce_if_possible(session, phase, version, actor=actor)
    return version


def enforce_ground_truth(session: Session, phase: Phase, version: GroundTruthVersion, *, actor: str) -> None:
    """Let a version rank from now on, for the whole leaderboard at once.

    Raises:
        Conflict: A published submission has no score on it.
    """
    if missing := _published_without_score(session, phase, version):
        message = (
            f"{missing} published submissions have no score on version {version.version}; `cs3d-admin rescore` them"
        )
        raise Conflict(message)
    phase.ground_truth = version
    audit.record(
        session,
        actor=actor,
        action="ground_truth.enforced",
        subject=audit.subject_of(phase),
        version=version.version,
    )
    session.flush()


def _lock(session: Session, phase: Phase) -> None:
    """Let nobody else publish in the phase or change its ground truth until the transaction ends."""
    session.execute(sa.select(Phase.id).where(Phase.id == phase.id).with_for_update(key_share=True))


def _published_without_score(session: Session, phase: Phase, version: GroundTruthVersion) -> int:
    """Count the published submissions that would lose their row; nobody publishes in the phase meanwhile."""
    _lock(session, phase)
    scored = sa.exists().where(
        Score.submission_id == Submission.id,
        Score.ground_truth_id == version.id,
        Score.protocol == phase.protocol,
    )
    query = sa.select(sa.func.count()).where(
        Submission.phase_id == phase.id,
        Submission.state == SubmissionState.SCORED,
        Submission.publication == Publication.PUBLISHED,
        ~scored,
    )
    return session.scalar(query) or 0


def _is_rescored(session: Session, phase: Phase) -> bool:
    """Say whether a re-scoring of the phase runs: what it was begun to replace must stay in force."""
    running = sa.select(Rescoring.id).where(Rescoring.phase_id == phase.id, Rescoring.state == RescoringState.RUNNING)
    return session.scalar(running) is not None


def canonical_zip(source: Path) -> bytes:
    """Pack the files of ground truth that was read so that equal files give equal bytes: sorted, dateless, base names."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name, data in sorted(ground_truth_files(source).items()):
            member = zipfile.ZipInfo(name, ZIP_EPOCH)
            member.compress_type = zipfile.ZIP_DEFLATED
            member.external_attr = 0o644 << 16
            archive.writestr(member, data)
    return buffer.getvalue()
