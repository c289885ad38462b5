"""The process that reads participants' bytes: what it cannot do, and how its deaths are told."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import psutil
import pytest

from evaluator.ground_truth import read_ground_truth
from server.models import SubmissionState
from server.settings import MIB
from tests.integration.record import prying_child
from tests.services.installation import SMALL_CASE, Installation, zip_of
from tests.services.worker import ROOT
from worker import confinement
from worker.child import EXIT_MEMORY, EXIT_NO_ROOM
from worker.messages import Broken, Exit, Job, Ready, Rejected, Scored, Validated
from worker.sandbox import Sandbox, SandboxError

NOBODY = 65534

needs_landlock = pytest.mark.skipif(not confinement.can_confine_files(), reason="the kernel does not confine files")


@pytest.fixture(name="sandbox")
def _sandbox() -> Iterator[Sandbox]:
    """Give a sandbox, ended after the test."""
    sandbox = Sandbox()
    yield sandbox
    sandbox.kill()


@pytest.fixture
def job(tmp_path: Path) -> Job:
    """Give a job with the small case."""
    ground_truth = read_ground_truth(SMALL_CASE / "gt")
    (tmp_path / "ground_truth").write_bytes(ground_truth.to_bytes())
    (tmp_path / "images").write_bytes(msgspec.json.encode(ground_truth.image_list()))
    (tmp_path / "predictions").write_bytes(zip_of(SMALL_CASE / "pred"))
    (tmp_path / "out").mkdir()
    return Job(
        predictions=str(tmp_path / "predictions"),
        ground_truth=str(tmp_path / "ground_truth"),
        image_list=str(tmp_path / "images"),
        predictions_sha256="p",
        ground_truth_sha256="g",
        protocol="cityscapes3d",
        folder=str(tmp_path / "out"),
        memory_bytes=2048 * MIB,
        time_s=60,
    )


def _kinds(sandbox: Sandbox, job: Job) -> list[type]:
    kinds = [type(event) for event in sandbox.events(job, tick_s=1)]
    return [kind for kind in kinds if kind in (Validated, Rejected, Scored, Broken, Exit)]


def _process(sandbox: Sandbox) -> psutil.Process:
    process = sandbox._process
    assert process is not None
    return psutil.Process(process.pid)


def test_one_process_does_many_jobs(sandbox: Sandbox, job: Job) -> None:
    """The evaluator is loaded once; every job is a fork that ends with its results in the folder."""
    assert _kinds(sandbox, job) == [Validated, Scored, Exit]
    first = _process(sandbox).pid
    Path(job.predictions).write_bytes(b"no zip")
    assert _kinds(sandbox, job) == [Rejected, Exit]
    assert _process(sandbox).pid == first
    assert {path.name for path in Path(job.folder).iterdir()} >= {"report.json", "scores.json", "statistics"}


def test_the_child_has_no_credentials(sandbox: Sandbox, job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the worker's environment that could be a secret reaches the process that parses user bytes."""
    monkeypatch.setenv("CS3D_DATABASE_URL", "postgresql+psycopg://user:secret@db/x")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    _kinds(sandbox, job)
    environment = _process(sandbox).environ()
    assert "secret" not in " ".join(environment.values())
    assert not [name for name in environment if name.startswith(("CS3D_", "AWS_"))]


def test_the_child_computes_on_one_thread(sandbox: Sandbox, job: Job) -> None:
    """As many jobs run as there are processors, so no library starts threads of its own."""
    _kinds(sandbox, job)
    environment = _process(sandbox).environ()
    assert [environment.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")] == ["1", "1"]
    assert _process(sandbox).num_threads() == 1


@pytest.mark.skipif(os.getuid() != 0, reason="only root can always make a network namespace")
def test_the_child_has_no_network(sandbox: Sandbox, job: Job) -> None:
    """The scoring process is in a network namespace of its own, so not even this machine can be reached."""
    _kinds(sandbox, job)
    theirs = Path(f"/proc/{_process(sandbox).pid}/ns/net").readlink()
    assert theirs != Path("/proc/self/ns/net").readlink()


def test_memory_is_bounded(sandbox: Sandbox, job: Job) -> None:
    """A job that needs more memory than allowed ends with its own status; the next job is not affected."""
    last = list(sandbox.events(msgspec.structs.replace(job, memory_bytes=64 * MIB), tick_s=1))[-1]
    assert last == Exit(status=EXIT_MEMORY)
    assert _kinds(sandbox, job)[-2:] == [Scored, Exit]


def test_a_full_disk_is_told(sandbox: Sandbox, job: Job) -> None:
    """A job whose results find no room ends with its own status: it is not the predictions' fault, nor the evaluator's."""
    report = Path(job.folder) / "report.json"
    report.symlink_to("/dev/full")  # what is written there meets a full disk
    assert list(sandbox.events(job, tick_s=1))[-1] == Exit(status=EXIT_NO_ROOM)
    report.unlink()
    assert _kinds(sandbox, job)[-2:] == [Scored, Exit]


def test_time_is_bounded(sandbox: Sandbox, job: Job) -> None:
    """A job that takes too long is killed and told as such; the next job gets a new process."""
    os.mkfifo(fifo := str(Path(job.folder) / "fifo"))
    endless = msgspec.structs.replace(job, image_list=fifo, time_s=0.5)  # nobody ever writes to it
    assert list(sandbox.events(endless, tick_s=0.1))[-1] == Exit(status=-signal.SIGXCPU)
    assert _kinds(sandbox, job)[-2:] == [Scored, Exit]


def test_a_killed_child_is_told(sandbox: Sandbox, job: Job) -> None:
    """SIGKILL of the scoring process, as the kernel does when memory runs out, is an event and no hang."""
    os.mkfifo(fifo := str(Path(job.folder) / "fifo"))
    events = sandbox.events(msgspec.structs.replace(job, image_list=fifo), tick_s=0.2)
    assert next(events) is None
    for child in _process(sandbox).children():
        child.kill()
    assert [event for event in events if event] == [Exit(status=-signal.SIGKILL)]


def test_a_broken_evaluator_is_told_without_data(sandbox: Sandbox, job: Job) -> None:
    """An error of ours names its kind and place and nothing of the ground truth."""
    Path(job.ground_truth).write_bytes(b"damaged ground truth")
    broken = [event for event in sandbox.events(job, tick_s=1) if isinstance(event, Broken)]
    assert len(broken) == 1
    assert "damaged" not in broken[0].detail
    assert ".py:" in broken[0].detail


def test_abandoning_a_job_kills_it(sandbox: Sandbox, job: Job) -> None:
    """A worker that lost its lease closes the iterator; nothing of the job goes on."""
    os.mkfifo(fifo := str(Path(job.folder) / "fifo"))
    events = sandbox.events(msgspec.structs.replace(job, image_list=fifo), tick_s=0.1)
    assert next(events) is None
    process = _process(sandbox)
    events.close()
    assert not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    assert sandbox._process is None


def test_sockets_are_not_inherited(sandbox: Sandbox, job: Job) -> None:
    """No connection of the worker's is open in the scoring process."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        _kinds(sandbox, job)
        assert _process(sandbox).net_connections() == []


def _possible(job: Job) -> list[str]:
    return list(json.loads((Path(job.folder) / "possible.json").read_text()))


@needs_landlock
def test_a_job_reaches_its_own_files_only(sandbox: Sandbox, job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes that took over the scoring process read what they are scored with, and nothing of the worker; they write nothing.

    Root's scoring process, too, although it owns every file.
    """
    Path(job.folder).with_name("secret").write_bytes(b"secret")
    monkeypatch.setattr("worker.sandbox.PROGRAM", prying_child.__name__)
    assert _kinds(sandbox, job) == [Scored, Exit]
    assert _possible(job) == ["read its input", "read our modules"]
    assert Path(job.ground_truth).read_bytes() != b"other ground truth"


@needs_landlock
@pytest.mark.skipif(os.getuid() != 0, reason="otherwise the test above is one of an ordinary user")
def test_an_ordinary_user_is_confined_like_root(job: Job) -> None:
    """Giving up files and sockets takes no rights: a user without any owns the ground truth and cannot change it."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "job"
        shutil.copytree(Path(job.folder).parent, root)
        (root / "secret").write_bytes(b"secret")
        for path in (Path(folder), root, *root.iterdir()):
            os.chown(path, NOBODY, NOBODY)
        text = msgspec.json.encode(job).decode().replace(str(Path(job.folder).parent), str(root))
        theirs = msgspec.json.decode(text, type=Job)
        command = [sys.executable, "-m", prying_child.__name__, str(os.getpid()), str(NOBODY)]
        subprocess.run(command, input=msgspec.json.encode(theirs) + b"\n", cwd=ROOT, check=True, capture_output=True)
        assert set(_possible(theirs)) - {"read our modules"} == {"read its input"}  # where our modules are all users'


HIDING = """
import os, sys, ctypes
from worker.confinement import hide_memory
if os.getuid() == 0:
    os.setresuid(65534, 65534, 65534)
ctypes.CDLL(None).prctl(4, 1, 0, 0, 0)  # as a program that is executed starts
for hide in (lambda: None, hide_memory):
    hide()
    worker = os.getpid()
    if (child := os.fork()) == 0:
        try:
            open(f"/proc/{worker}/environ", "rb").read()
        except PermissionError:
            os._exit(1)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux shows environments as files")
def test_a_worker_hides_its_environment(tmp_path: Path) -> None:
    """Without Landlock, too, a process of the same user cannot read what a worker that hid its memory holds."""
    (tmp_path / "hiding.py").write_text(HIDING)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(tmp_path / "hiding.py")]
    run = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    assert run.stdout.split() == ["0", "1"]


@pytest.mark.parametrize(("network", "files"), [(True, False), (False, True)])
def test_what_is_not_confined_may_be_refused(monkeypatch: pytest.MonkeyPatch, *, network: bool, files: bool) -> None:
    """Where the kernel leaves something to the scoring process, a sandbox that must be whole takes no job; others do."""
    ready = Ready(has_network=network, has_files=files)
    monkeypatch.setattr(Sandbox, "_next_event", lambda *_: ready)
    Sandbox().check()
    with pytest.raises(SandboxError, match="network" if network else "files"):
        Sandbox(must_confine=True).check()


@needs_landlock
def test_a_worker_starts_where_the_sandbox_is_whole(installation: Installation) -> None:
    """A worker that requires the sandbox scores where there is one."""
    submission_id = installation.submit()
    installation.start_worker(extra={"CS3D_SANDBOX_REQUIRED": "1"})
    installation.wait_for(submission_id, SubmissionState.SCORED)


def test_a_worker_refuses_to_start_without_the_sandbox(installation: Installation) -> None:
    """A worker that requires the sandbox ends at once where there is none, and says why."""
    with pytest.raises(RuntimeError, match="leaves the scoring process its network"):
        installation.start_worker(module="tests.integration.record.open_child", extra={"CS3D_SANDBOX_REQUIRED": "1"})
    process = installation.workers[0].process
    assert process is not None
    assert process.wait() != 0
