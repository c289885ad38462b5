"""Three methods whose order depends on the ground truth, and the means to score them again.

The first ground truth is the small case's; the second lacks one car. `complete` predicts the first one box for box,
`partial` the second; `rough` is `partial` turned by 60 degrees, at its worst on both.
"""

import io
import json
import math
import uuid
import zipfile
from pathlib import Path
from typing import Any

import pytest
import structlog
from sqlalchemy.orm import Session

from server import benchmarks, ranking, rescoring, rescoring_decisions, submissions
from server.admin.main import main
from server.models import ItemState, Phase, SubmissionState
from server.rescoring import Progress
from tests.services.installation import SMALL_CASE, Installation
from worker.evaluation import evaluate_submission
from worker.rescoring import evaluate_item
from worker.sandbox import Sandbox

GONE_X_M = 42.0
"""Centre of the car that the second ground truth lacks."""

Boxes = dict[str, list[dict[str, Any]]]


def _boxes(*, complete: bool) -> Boxes:
    return {
        path.name.removesuffix("_gtBbox3d.json"): [
            box for box in json.loads(path.read_text())["objects"] if complete or box["3d"]["center"][0] != GONE_X_M
        ]
        for path in sorted((SMALL_CASE / "gt").iterdir())
    }


def second_ground_truth(folder: Path) -> Path:
    """Write the ground truth without the car."""
    target = folder / "second"
    target.mkdir(exist_ok=True)
    for image, boxes in _boxes(complete=False).items():
        name = f"{image}_gtBbox3d.json"
        frame = json.loads((SMALL_CASE / "gt" / name).read_text())
        (target / name).write_text(json.dumps({**frame, "objects": boxes}))
    return target


def predictions(method: str) -> bytes:
    """Pack what a method predicts."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for image, boxes in _boxes(complete=method == "complete").items():
            content = {"objects": [_prediction(box, turned=method == "rough") for box in boxes]}
            archive.writestr(f"{image}_predBbox3d.json", json.dumps(content))
    return buffer.getvalue()


def _prediction(box: dict[str, Any], *, turned: bool) -> dict[str, Any]:
    rotation = [math.cos(math.pi / 6), 0.0, 0.0, math.sin(math.pi / 6)] if turned else box["3d"]["rotation"]
    place = {"center": box["3d"]["center"], "dimensions": box["3d"]["dimensions"], "rotation": rotation}
    return {"2d": box["2d"], "3d": place, "label": box["label"], "score": 0.9}


class Rescored:
    """An installation with published submissions that are scored again."""

    def __init__(self, installation: Installation, sandbox: Sandbox) -> None:
        """Take an installation without workers; `work` does what one would do."""
        self.installation = installation
        self.services = installation.services
        self.sandbox = sandbox
        self.ids: dict[str, uuid.UUID] = {}

    def add(self, method: str, *, publish: bool = True) -> uuid.UUID:
        """Send, score and publish a method's predictions."""
        submission_id = self.installation.submit(predictions(method), method=method, enqueue=False)
        evaluate_submission(self.services, self.sandbox, submission_id, worker="w")
        assert self.installation.state(submission_id) is SubmissionState.SCORED
        self.ids[method] = submission_id
        if publish:
            with self.services.transaction() as session:
                submissions.publish(session, submissions.find(session, submission_id), "user:1")
        return submission_id

    def phase(self, session: Session) -> Phase:
        """Read the phase."""
        return benchmarks.find_phase(session, "cs3d", "test")

    def start(self, *, protocol: str | None = None, new_ground_truth: bool = True) -> list[int]:
        """Begin to score again on the second ground truth; give the items that wait. Nothing is sent."""
        source = second_ground_truth(self.installation.folder)
        blobs = self.services.blobs
        prepared = benchmarks.prepare_ground_truth(blobs, source) if new_ground_truth else None
        with self.services.transaction() as session:
            phase = self.phase(session)
            number = None
            if prepared is not None:
                number = benchmarks.add_ground_truth(
                    session, blobs, phase=phase, prepared=prepared, actor="admin:test"
                ).version
            one = rescoring.start(session, phase=phase, version=number, protocol=protocol, actor="admin:test")
            return rescoring.waiting(session, one)

    def work(self, *items: int) -> None:
        """Do a worker's work on items."""
        for item_id in items:
            evaluate_item(self.services, self.sandbox, item_id, worker="w")

    def progress(self) -> Progress:
        """Read how far it is."""
        with self.services.snapshot() as session:
            return rescoring.progress(session, rescoring.get_running(session, self.phase(session)))

    def counts(self) -> dict[ItemState, int]:
        """Read how many items are in which state, of the states that any is in."""
        return {state: number for state, number in self.progress().counts.items() if number}

    def publish(self) -> None:
        """Put it in force."""
        with self.services.transaction() as session:
            rescoring_decisions.publish(session, self.phase(session), "admin:test")

    def board(self) -> list[tuple[str, int | None]]:
        """Read the leaderboard: methods with their ranks."""
        with self.services.snapshot() as session:
            return [(row.method.slug, row.rank) for row in ranking.leaderboard(session, self.phase(session)).rows]


def run(installation: Installation, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """Run `cs3d-admin` on an installation."""
    for name, value in installation.settings.environment().items():
        monkeypatch.setenv(name, value)
    try:
        return main(arguments)
    finally:
        structlog.reset_defaults()  # a command sends the log to standard error
