"""The commands of `cs3d-admin` on a data folder: how they start, refuse and print; backup, check and re-queueing."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from server import benchmarks, submissions
from server.admin.main import main
from server.models import SubmissionState
from server.services import Services
from server.settings import Settings
from tests.unit.admin.filled import Admin, fail_one, populate

ROOT = Path(__file__).resolve().parents[3]


def test_init_may_be_run_again(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A second `init` changes nothing: the secret key stays."""
    key = (data_dir / "secret_key").read_text()
    assert main(["init", "--data-dir", str(data_dir)]) == 0
    assert (data_dir / "secret_key").read_text() == key
    assert "is migrated" in capsys.readouterr().out


def test_a_failed_submission_is_queued_again(admin: Admin, services: Services, data_dir: Path) -> None:
    """`requeue --all-failed` finds it; without a broker it says that no message was sent."""
    populate(admin)
    submission_id = fail_one(services)
    # A process of its own, as in life: Celery keeps connections open for as long as a process lives.
    command = [sys.executable, "-m", "server.admin.main", "requeue", "--all-failed", "--json"]
    done = subprocess.run([*command, "--data-dir", data_dir], capture_output=True, text=True, check=True, cwd=ROOT)
    assert json.loads(done.stdout) == {"requeued": [str(submission_id)], "sent": False}
    with services.snapshot() as session:
        assert submissions.find(session, submission_id).state is SubmissionState.RECEIVED


def test_only_scored_submissions_are_published(
    data_dir: Path, admin: Admin, services: Services, capsys: pytest.CaptureFixture[str]
) -> None:
    """Publishing a failed submission is refused with the code not_scored; with --json on stderr as JSON."""
    populate(admin)
    submission_id = fail_one(services)
    assert main(["publish", str(submission_id), "--data-dir", str(data_dir), "--json"]) == 1
    assert json.loads(capsys.readouterr().err)["error"]["code"] == "not_scored"


def test_granted_submissions_are_in_the_ledger(admin: Admin, services: Services) -> None:
    """`grant` lets a team send more."""
    populate(admin)
    granted = admin("grant", "cs3d", "test", "lab", "5", "--reason", "broken upload")
    assert granted["granted"] == 5
    with services.snapshot() as session:
        assert benchmarks.find_phase(session, "cs3d", "test").submissions_per_day == 10


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["create-team", "lab", "--name", "Lab", "--member", "nobody@example.org"], 1, "create-user"),
        (["create-phase", "nothing", "test", "--title", "T"], 1, "no benchmark"),
        (["import-ground-truth", "a", "b", "missing-folder"], 2, "does not exist"),
        (["requeue"], 2, "--all-failed"),
        (["publish", "not-an-id"], 1, "no submission"),
    ],
)
def test_what_cannot_be_done_is_said_on_stderr(
    data_dir: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], status: int, said: str
) -> None:
    """Refusals exit with 1, wrong usage with 2, and the message names the fix."""
    assert main([*arguments, "--data-dir", str(data_dir)]) == status
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.out == ""


def test_an_installation_without_tables_is_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A command before `init` says that `init` is missing."""
    assert main(["create-team", "lab", "--name", "Lab", "--data-dir", str(tmp_path / "new")]) == 1
    assert "cs3d-admin init" in capsys.readouterr().err


def test_settings_that_cannot_be_are_wrong_usage(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A heartbeat longer than the lease is refused before anything is opened."""
    monkeypatch.setenv("CS3D_HEARTBEAT_S", "100")
    assert main(["status"]) == 2
    assert "heartbeat_s" in capsys.readouterr().err


def test_results_are_sentences_without_json(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For people a command prints a sentence that names the next step."""
    capsys.readouterr()
    assert main(["create-benchmark", "cs3d", "--title", "T", "--data-dir", str(data_dir)]) == 0
    assert "cs3d-admin create-phase cs3d" in capsys.readouterr().out


def test_a_backup_is_restored_elsewhere(
    admin: Admin, services: Services, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other installation has the same rows and passes the check; a second restore is refused."""
    populate(admin)
    submission_id = fail_one(services)
    written = admin("backup", str(tmp_path / "backup"))
    elsewhere = ["--data-dir", str(tmp_path / "elsewhere"), "--json"]
    assert main(["restore", str(tmp_path / "backup"), *elsewhere]) == 0
    assert json.loads(capsys.readouterr().out)["rows"] == written["rows"]
    assert main(["check", *elsewhere]) == 0
    restored = Services.from_settings(Settings(data_dir=tmp_path / "elsewhere"))
    with restored.snapshot() as session:
        assert submissions.find(session, submission_id).state is SubmissionState.FAILED
    assert main(["restore", str(tmp_path / "backup"), *elsewhere]) == 1


def test_check_names_what_does_not_hold(
    admin: Admin, services: Services, data_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A blob deleted behind the record's back is found: status 1, with rule and digest."""
    populate(admin)
    assert admin("check") == {"violations": []}
    with services.snapshot() as session:
        version = benchmarks.find_phase(session, "cs3d", "test").ground_truth
        assert version is not None
        sha256 = version.source_sha256
    services.blobs.delete(sha256)
    assert main(["check", "--quick", "--data-dir", str(data_dir), "--json"]) == 1
    violations = json.loads(capsys.readouterr().out)["violations"]
    assert ("every_row_has_its_blob", True) in {(found["rule"], sha256 in str(found)) for found in violations}
