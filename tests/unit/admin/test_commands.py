"""The commands of `cs3d-admin` on a data folder: from an empty machine to a benchmark that takes submissions."""

import io
import json
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import structlog

from evaluator.synthetic import synthesize_ground_truth, write_zip
from server import accounts, benchmarks, lifecycle, submissions
from server.admin.main import main
from server.errors import NotAuthenticated
from server.models import SubmissionState
from server.services import Services
from server.settings import Settings

ROOT = Path(__file__).resolve().parents[3]

Admin = Callable[..., dict[str, Any]]


@pytest.fixture(autouse=True)
def _usual_logging() -> Iterator[None]:
    """Leave logging to other tests as it was: a command sends it to standard error."""
    yield
    structlog.reset_defaults()


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """An installation that `init` made."""
    folder = tmp_path / "data"
    assert main(["init", "--data-dir", str(folder)]) == 0
    return folder


@pytest.fixture
def admin(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> Admin:
    """Run a command with --json and return what it prints; it must succeed."""

    def run(*arguments: str) -> dict[str, Any]:
        capsys.readouterr()
        status = main([*arguments, "--data-dir", str(data_dir), "--json"])
        printed = capsys.readouterr()
        assert status == 0, printed.err
        document: dict[str, Any] = json.loads(printed.out)
        return document

    return run


@pytest.fixture
def services(data_dir: Path) -> Services:
    """The installation as the server sees it."""
    return Services.from_settings(Settings(data_dir=data_dir))


def _populate(admin: Admin, tmp_path: Path) -> None:
    """Make a team with a member and a phase with ground truth."""
    admin("create-user", "ann@example.org", "--name", "Ann")
    admin("create-team", "lab", "--name", "The Lab", "--member", "ann@example.org")
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test")
    write_zip(synthesize_ground_truth(3, seed=1), tmp_path / "gt.zip")
    admin("import-ground-truth", "cs3d", "test", str(tmp_path / "gt.zip"))


def test_init_may_be_run_again(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A second `init` changes nothing: the secret key stays."""
    key = (data_dir / "secret_key").read_text()
    assert main(["init", "--data-dir", str(data_dir)]) == 0
    assert (data_dir / "secret_key").read_text() == key
    assert "is migrated" in capsys.readouterr().out


def test_a_generated_password_is_shown_once_and_works(admin: Admin, services: Services) -> None:
    """`create-user` prints a password with which the user can log in."""
    created = admin("create-user", "Ann@Example.org", "--name", "Ann", "--maintainer")
    with services.transaction() as session:
        user = accounts.authenticate_password(session, "ann@example.org", created["password"])
        assert user.is_maintainer


def test_a_password_may_come_from_standard_input(
    admin: Admin, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With --password-stdin the first line is the password, and it is not printed."""
    monkeypatch.setattr("sys.stdin", io.StringIO("a long password\n"))
    created = admin("create-user", "ann@example.org", "--name", "Ann", "--password-stdin")
    assert "password" not in created
    with services.transaction() as session:
        assert accounts.authenticate_password(session, "ann@example.org", "a long password").name == "Ann"


def test_tokens_act_for_a_team(admin: Admin, services: Services) -> None:
    """A token works for the team it was made for, and only members get one."""
    admin("create-user", "ann@example.org", "--name", "Ann")
    admin("create-team", "lab", "--name", "The Lab")
    admin("add-member", "lab", "ann@example.org")
    created = admin("create-token", "ann@example.org", "lab", "--days", "30")
    with services.transaction() as session:
        token = accounts.authenticate_token(session, created["token"])
        assert (token.user.email, token.team.slug) == ("ann@example.org", "lab")
        assert token.expires_at is not None


def test_phases_keep_their_rules(admin: Admin, services: Services) -> None:
    """The options of `create-phase` become the phase's rules; a time without a zone is UTC."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D", "--description", "Vehicles in nine degrees.")
    options = ["--open", "--no-publication", "--submissions-per-day", "3", "--closes-at", "2030-01-02T03:04"]
    admin("create-phase", "cs3d", "val", "--title", "Validation", *options)
    with services.snapshot() as session:
        phase = benchmarks.find_phase(session, "cs3d", "val")
        assert (phase.is_open, phase.allows_publication, phase.submissions_per_day) == (True, False, 3)
        assert phase.closes_at is not None
        assert phase.closes_at.isoformat() == "2030-01-02T03:04:00+00:00"


def test_phases_keep_their_number_of_shards(admin: Admin, services: Services, data_dir: Path) -> None:
    """`create-phase --shards` chooses it, `set-shards` another one; a number that cannot be changes nothing."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test", "--shards", "4")
    with services.snapshot() as session:
        assert benchmarks.find_phase(session, "cs3d", "test").shards == 4
    admin("set-shards", "cs3d", "test", "2")
    assert main(["set-shards", "cs3d", "test", "65", "--data-dir", str(data_dir)]) == 1
    with services.snapshot() as session:
        assert benchmarks.find_phase(session, "cs3d", "test").shards == 2


@pytest.mark.parametrize("packed", [True, False], ids=["zip", "folder"])
def test_ground_truth_comes_as_a_folder_or_a_zip(admin: Admin, tmp_path: Path, *, packed: bool) -> None:
    """Both forms give the same version, which is in force at once."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test")
    files = synthesize_ground_truth(4, seed=5)
    source = tmp_path / ("gt.zip" if packed else "gt")
    if packed:
        write_zip(files, source)
    else:
        source.mkdir()
        for name, content in files.items():
            (source / name).write_bytes(content)
    imported = admin("import-ground-truth", "cs3d", "test", str(source))
    boxes = sum(len(json.loads(content)["objects"]) for content in files.values())
    assert (imported["version"], imported["images"], imported["boxes"]) == (1, 4, boxes)
    assert imported["in_force"]


def test_ground_truth_with_errors_is_refused(
    data_dir: Path, admin: Admin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is imported, and the message names the file that is wrong."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test")
    folder = tmp_path / "gt"
    folder.mkdir()
    (folder / "bonn_000000_000019_gtBbox3d.json").write_text("{")
    command = ["import-ground-truth", "cs3d", "test", str(folder), "--data-dir", str(data_dir)]
    assert main(command) == 1
    assert "bonn_000000_000019_gtBbox3d.json" in capsys.readouterr().err


def test_a_failed_submission_is_queued_again(admin: Admin, services: Services, data_dir: Path, tmp_path: Path) -> None:
    """`requeue --all-failed` finds it; without a broker it says that no message was sent."""
    _populate(admin, tmp_path)
    submission_id = _fail_one(services)
    # A process of its own, as in life: Celery keeps connections open for as long as a process lives.
    command = [sys.executable, "-m", "server.admin.main", "requeue", "--all-failed", "--json"]
    done = subprocess.run([*command, "--data-dir", data_dir], capture_output=True, text=True, check=True, cwd=ROOT)
    assert json.loads(done.stdout) == {"requeued": [str(submission_id)], "sent": False}
    with services.snapshot() as session:
        assert submissions.find(session, submission_id).state is SubmissionState.RECEIVED


def _fail_one(services: Services) -> uuid.UUID:
    """Make a submission whose worker fails."""
    sha256 = services.blobs.put_bytes(b"zip")
    with services.transaction() as session:
        submission = submissions.receive(
            session,
            phase=benchmarks.find_phase(session, "cs3d", "test"),
            team=accounts.find_team(session, "lab"),
            user=accounts.find_user(session, "ann@example.org"),
            method_slug="ours",
            predictions_sha256=sha256,
            size_bytes=3,
            file_name="a.zip",
            actor="user:1",
        )
        held = lifecycle.claim(session, submission.id, worker="w", lease_s=60)
        assert held is not None
        lifecycle.fail(session, held, code="out_of_memory", detail="4 GiB were not enough")
    return submission.id


def test_only_scored_submissions_are_published(
    data_dir: Path, admin: Admin, services: Services, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Publishing a failed submission is refused with the code not_scored; with --json on stderr as JSON."""
    _populate(admin, tmp_path)
    submission_id = _fail_one(services)
    assert main(["publish", str(submission_id), "--data-dir", str(data_dir), "--json"]) == 1
    assert json.loads(capsys.readouterr().err)["error"]["code"] == "not_scored"


def test_granted_submissions_are_in_the_ledger(admin: Admin, services: Services, tmp_path: Path) -> None:
    """`grant` lets a team send more."""
    _populate(admin, tmp_path)
    granted = admin("grant", "cs3d", "test", "lab", "5", "--reason", "broken upload")
    assert granted["granted"] == 5
    with services.snapshot() as session:
        assert benchmarks.find_phase(session, "cs3d", "test").submissions_per_day == 10


def test_status_counts_by_state_and_reports_a_dead_broker(
    data_dir: Path, admin: Admin, services: Services, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a broker the status is 1, and the counts are there all the same."""
    _populate(admin, tmp_path)
    _fail_one(services)
    assert main(["status", "--data-dir", str(data_dir), "--json"]) == 1
    status = json.loads(capsys.readouterr().out)
    assert status["broker_depth"] is None
    (phase,) = status["phases"]
    assert (phase["phase"], phase["version"], phase["states"]["failed"]) == ("test", 1, 1)


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
    _populate(admin, tmp_path)
    submission_id = _fail_one(services)
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
    admin: Admin, services: Services, data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A blob deleted behind the record's back is found: status 1, with rule and digest."""
    _populate(admin, tmp_path)
    assert admin("check") == {"violations": []}
    with services.snapshot() as session:
        version = benchmarks.find_phase(session, "cs3d", "test").ground_truth
        assert version is not None
        sha256 = version.source_sha256
    services.blobs.delete(sha256)
    assert main(["check", "--quick", "--data-dir", str(data_dir), "--json"]) == 1
    violations = json.loads(capsys.readouterr().out)["violations"]
    assert ("every_row_has_its_blob", True) in {(found["rule"], sha256 in str(found)) for found in violations}


def test_a_password_is_replaced_and_access_ended(admin: Admin, services: Services) -> None:
    """The new password logs in, the old one does not; a disabled user has neither password nor token."""
    old = admin("create-user", "ann@example.org", "--name", "Ann")["password"]
    admin("create-team", "lab", "--name", "The Lab", "--member", "ann@example.org")
    secret = admin("create-token", "ann@example.org", "lab")["token"]
    new = admin("set-password", "ann@example.org")["password"]
    with services.transaction() as session:
        assert accounts.authenticate_password(session, "ann@example.org", new).name == "Ann"
        with pytest.raises(NotAuthenticated):
            accounts.authenticate_password(session, "ann@example.org", old)
        assert accounts.authenticate_token(session, secret).name == "cs3d-admin"
    admin("disable-user", "ann@example.org")
    with services.transaction() as session:
        with pytest.raises(NotAuthenticated):
            accounts.authenticate_password(session, "ann@example.org", new)
        with pytest.raises(NotAuthenticated):
            accounts.authenticate_token(session, secret)
