"""An archive may be as large as the setting says, at the door and at every reading after it."""

import hashlib
import io
import uuid
import zipfile
from pathlib import Path
from typing import Any

import pytest

from evaluator.limits import DEFAULT_LIMITS
from server import accounts, checker, submissions
from server.api import receiving
from server.api.orders import Order
from server.api.receiving import Admission
from server.api.spool import SpooledFile
from server.models import SubmissionState
from server.services import Services
from server.submissions import NOTHING_SAID
from worker.evaluation import evaluate_submission
from worker.sandbox import Sandbox

pytestmark = pytest.mark.parametrize("shape", ["embedded"], indirect=True)
"""Only here does the archive, which is one large hole, take no room."""


class HoleFile(io.FileIO):
    """A file that zeros take no room in."""

    def write(self, data: Any, /) -> int:
        """Write, or step over zeros."""
        size = memoryview(data).nbytes
        if bytes(data).count(0) < size:
            return super().write(data)
        self.seek(size, io.SEEK_CUR)
        return size


def write_padded(path: Path, archive: bytes) -> None:
    """Write predictions with ignored members of zeros beside them, to just beyond what is taken by default."""
    member = bytes(DEFAULT_LIMITS.file_bytes)
    with (
        HoleFile(path, "w+") as file,
        zipfile.ZipFile(file, "w") as padded,
        zipfile.ZipFile(io.BytesIO(archive)) as own,
    ):
        for number in range(DEFAULT_LIMITS.archive_bytes // len(member)):
            padded.writestr(f"__MACOSX/{number}", member)
        for name in own.namelist():
            padded.writestr(name, own.read(name))


def sent(services: Services, path: Path) -> uuid.UUID:
    """Take what has arrived under the cap of the setting."""
    with services.snapshot() as session:
        ann, lab = accounts.find_user(session, "ann@example.org"), accounts.find_team(session, "lab")
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    order = Order(benchmark="cs3d", phase="test", method="large", shown=NOTHING_SAID)
    return receiving.keep(
        services, Admission(ann.id, lab.id, "user:1"), order, SpooledFile(path, sha256, path.stat().st_size)
    )


def test_more_than_the_default_is_taken_scored_and_verified(
    quiet_services: Services, sandbox: Sandbox, archive: bytes, tmp_path: Path
) -> None:
    """Where an installation takes more than 512 MiB, such an archive is accepted, scored and computed again."""
    path = tmp_path / "large.zip"
    write_padded(path, archive)
    assert path.stat().st_size > DEFAULT_LIMITS.archive_bytes

    submission_id = sent(quiet_services, path)
    evaluate_submission(quiet_services, sandbox, submission_id, worker="test")

    with quiet_services.snapshot() as session:
        assert submissions.find(session, submission_id).state is SubmissionState.SCORED
        assert list(checker.scores_are_reproducible(quiet_services, session)) == []
