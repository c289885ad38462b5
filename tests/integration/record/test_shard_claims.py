"""Claims of shards: what is lost, late or given back, and what the record refuses."""

from collections.abc import Callable, Iterator

import pytest
import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import lifecycle, shards
from server.checker import check
from server.claims import Claim, ShardClaim
from server.errors import InvalidField, ShardLost
from server.models import Phase, Shard, SubmissionState
from tests.integration.record.sharded import WatchedSandbox, divide, once, shard_rows
from tests.services.installation import Installation
from tests.services.processes import wait_until
from worker.evaluation import match_shard
from worker.messages import AnyJob, ShardJob


@pytest.fixture
def other_sandbox() -> Iterator[WatchedSandbox]:
    """Give the scoring process of a worker that does not hold the submission, ended after the test."""
    sandbox = WatchedSandbox()
    yield sandbox
    sandbox.kill()


def _divided(installation: Installation) -> Claim:
    """Hold a submission whose shards wait, as a worker does that has prepared it; its predictions are of no use."""
    services = installation.services
    submission_id = installation.submit(enqueue=False)
    with services.transaction() as session:
        held = lifecycle.claim(session, submission_id, worker="holder", lease_s=60)
        assert held is not None
    sha256 = services.blobs.put_bytes(b"arrays")
    with services.transaction() as session:
        shards.divide(session, services.blobs, held, predictions_sha256=sha256, ranges=[range(1), range(1, 2)])
    return held


def _claim(
    installation: Installation, held: Claim, number: int | None = None, lease_s: float = 60
) -> ShardClaim | None:
    with installation.services.transaction() as session:
        return shards.claim(session, held.submission_id, held.attempt, number, worker="other", lease_s=lease_s)


def test_a_shard_worker_writes_nothing_once_the_attempt_is_over(
    installation: Installation, other_sandbox: WatchedSandbox
) -> None:
    """The submission is taken from its holder while another worker has a shard: that worker finds it gone."""
    held = _divided(installation)

    def end(job: AnyJob) -> None:
        del job
        with installation.services.transaction() as session:
            lifecycle.cancel(session, held.submission_id, actor="user:1")

    other_sandbox.before = once(end, ShardJob)
    match_shard(installation.services, other_sandbox, held.submission_id, held.attempt, 0, worker="other")
    assert installation.state(held.submission_id) is SubmissionState.CANCELLED
    assert shard_rows(installation) == []


def test_a_late_claim_of_a_shard_writes_nothing(installation: Installation) -> None:
    """Whoever lost a shard to the next worker can neither renew, finish nor lose it; the next one can."""
    services, held = installation.services, _divided(installation)
    late = _claim(installation, held, 0, lease_s=0)
    wait_until(lambda: _claim(installation, held, 0), what="a lease that ran out")
    assert late is not None
    sha256 = services.blobs.put_bytes(b"shard")
    writes: tuple[Callable[[Session], None], ...] = (
        lambda session: shards.heartbeat(session, late),
        lambda session: shards.finish(session, services.blobs, late, result_sha256=sha256),
        lambda session: shards.lose(session, late, code="x", detail="y"),
        lambda session: shards.give_back(session, late),
    )
    for write in writes:
        with pytest.raises(ShardLost), services.transaction() as session:
            write(session)
    assert [(row.claims, row.worker, row.result_sha256) for row in shard_rows(installation)] == [
        (2, "other", None),
        (0, None, None),
    ]


def test_claims_given_back_do_not_count(installation: Installation) -> None:
    """A worker that lacks a service may give a shard back any number of times; three lost claims end it."""
    services, held = installation.services, _divided(installation)
    for _ in range(5):
        taken = _claim(installation, held, 0)
        assert taken is not None
        with services.transaction() as session:
            shards.give_back(session, taken)
    for _ in range(shards.CAP):
        taken = _claim(installation, held, 0)
        assert taken is not None
        with services.transaction() as session:
            assert shards.standing(session, held).failure is None
            shards.lose(session, taken, code="scoring_killed", detail="it was killed")
    assert _claim(installation, held, 0) is None
    with services.snapshot() as session:
        assert shards.standing(session, held).failure == ("scoring_killed", "images 0 to 0: it was killed")


def test_left_over_shards_are_found(installation: Installation) -> None:
    """The checker reports shards of an attempt that ended, and bytes that are not in the store."""
    held = _divided(installation)
    with installation.services.transaction() as session:
        lifecycle.cancel(session, held.submission_id, actor="user:1")
    assert check(installation.services, recompute=False) == []
    with installation.services.transaction() as session:
        session.add(
            Shard(
                submission_id=held.submission_id,
                attempt=held.attempt,
                number=0,
                first_image=1,
                end_image=2,
                predictions_sha256="0" * 64,
                ground_truth_sha256=held.ground_truth_sha256,
                protocol="cityscapes3d",
            )
        )
    found = [
        v.detail for v in check(installation.services, recompute=False) if v.rule == "shards_are_of_running_attempts"
    ]
    assert len(found) == 3  # the blob, the attempt that ended, the first image that is missing


@pytest.mark.parametrize("count", [0, 65])
def test_a_phase_has_1_to_64_shards(installation: Installation, count: int) -> None:
    """The record says so, and the database refuses whatever else comes."""
    with pytest.raises(InvalidField, match="shards"):
        divide(installation, count)
    with pytest.raises(sa.exc.IntegrityError), installation.services.transaction() as session:
        session.execute(sa.update(Phase).values(shards=count))
