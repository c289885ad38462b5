"""The process that reads participants' bytes: what it cannot do, and how its deaths are told."""

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import msgspec
import psutil
import pytest

from evaluator.ground_truth import read_ground_truth
from server.settings import MIB
from tests.services.installation import SMALL_CASE, zip_of
from worker.child import EXIT_MEMORY, EXIT_NO_ROOM
from worker.messages import Broken, Exit, Job, Rejected, Scored, Validated
from worker.sandbox import Sandbox


@pytest.fixture
def sandbox() -> Iterator[Sandbox]:
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
