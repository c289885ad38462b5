"""How a submission is compared with those of other teams when its score is recorded, in both shapes."""

import uuid
from collections.abc import Sequence
from typing import Any

import pytest

from evaluator.fingerprint import similarities
from evaluator.predictions import Float64Array
from server import accounts, integrity, submissions
from tests.integration.record.test_rescoring import rescored, sandbox
from tests.integration.record.three_methods import Rescored, predictions
from tests.services.installation import with_boxes
from worker.evaluation import evaluate_submission

__all__ = ["rescored", "sandbox"]


def _move(box: dict[str, Any]) -> None:
    """Move a box by three metres, so that no cell of half a metre is shared."""
    box["center"][0] += 3.0


def _score_for_others(rescored: Rescored, data: bytes) -> uuid.UUID:
    """Send and score predictions for another team."""
    services = rescored.services
    sha256 = services.blobs.put_bytes(data)
    with services.transaction() as session:
        submission_id = submissions.receive(
            session,
            phase=rescored.phase(session),
            team=accounts.find_team(session, "others"),
            user=accounts.find_user(session, "ann@example.org"),
            method_slug="theirs",
            predictions_sha256=sha256,
            size_bytes=len(data),
            file_name="predictions.zip",
            actor="user:1",
        ).id
    evaluate_submission(services, rescored.sandbox, submission_id, worker="w")
    return submission_id


def test_each_submission_is_compared_once(rescored: Rescored, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many scores a submission has, its predictions are looked at once, in batches, until a copy is found."""
    rescored.work(*rescored.start())
    rescored.publish()
    with rescored.services.transaction() as session:
        user = accounts.find_user(session, "ann@example.org")
        accounts.create_team(session, slug="others", name="Others", members=[user], actor="admin:test")
    batches: list[int] = []

    def counted(one: str, others: Sequence[str]) -> Float64Array:
        batches.append(len(others))
        return similarities(one, others)

    monkeypatch.setattr(integrity, "similarities", counted)
    monkeypatch.setattr(integrity, "BATCH", 2)
    moved = _score_for_others(rescored, with_boxes(predictions("complete"), _move))
    assert batches == [2, 1]  # three submissions with two scores each
    assert rescored.installation.load(moved).held_reason is None
    copy = _score_for_others(rescored, predictions("complete"))
    assert batches == [2, 1, 2]
    assert rescored.installation.load(copy).held_reason == integrity.COPIED
