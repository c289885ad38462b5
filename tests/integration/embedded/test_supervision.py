"""Children kept alive by a real supervisor, with real processes."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from server.errors import Unavailable
from server.supervision import FIRST_PAUSE_S, Child, Supervisor
from tests.services.processes import wait_until

ROOT = Path(__file__).resolve().parents[3]


def _child(name: str, script: str, ready: Callable[[], bool] = lambda: True, log_file: Path | None = None) -> Child:
    """A child that runs a shell script."""
    return Child(
        name=name,
        command=["/bin/sh", "-c", script],
        environment=dict(os.environ),
        is_ready=ready,
        ready_within_s=5,
        stop_within_s=5,
        log_file=log_file,
    )


def _pid(child: Child) -> int:
    assert child.process is not None
    return child.process.pid


def test_children_start_in_order_and_stop_in_reverse(tmp_path: Path) -> None:
    """Two children note when they end: the second one first."""
    ended = tmp_path / "ended"
    script = "trap 'echo {0} >> " + str(ended) + "; exit 0' TERM; touch {1}; while :; do sleep 0.02; done"
    children = [
        _child(name, script.format(name, tmp_path / name), ready=(tmp_path / name).exists) for name in ("a", "b")
    ]
    with Supervisor(children).running():
        assert all(child.running for child in children)
    assert ended.read_text().split() == ["b", "a"]


def test_a_dead_child_is_started_again_after_a_pause() -> None:
    """Killed by `kill -9`, it comes back as another process, and the next pause is twice as long."""
    child = _child("worker", "sleep 100")
    supervisor = Supervisor([child])
    with supervisor.running():
        first = _pid(child)
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: not child.running, timeout_s=5, what="the child is dead")

        def is_back() -> bool:
            supervisor.check()
            return child.running

        wait_until(is_back, timeout_s=10, what="the child is back")
        assert _pid(child) != first
        assert child.pause_s == 2 * FIRST_PAUSE_S


def test_what_a_child_started_ends_with_it() -> None:
    """A grandchild that ignores SIGTERM is gone once the supervisor has stopped."""
    child = _child("worker", "(trap '' TERM; sleep 100) & sleep 100")
    with Supervisor([child]).running():
        wait_until(lambda: len(psutil.Process(_pid(child)).children()) == 2, timeout_s=5, what="it has children")
        family = psutil.Process(_pid(child)).children(recursive=True)
    _, alive = psutil.wait_procs(family, timeout=5)
    assert alive == []


def test_a_child_that_does_not_come_up_is_an_error(tmp_path: Path) -> None:
    """It ends at once: the error gives its status and where its output is, and nothing is left running."""
    log_file = tmp_path / "logs" / "web.log"
    good = _child("broker", "sleep 100")
    bad = _child("web", "echo no port; exit 3", ready=lambda: False, log_file=log_file)
    with pytest.raises(Unavailable, match=r"web ended with status 3; see .*web\.log"):
        Supervisor([good, bad]).start()
    assert not good.running
    assert log_file.read_text() == "no port\n"


def test_children_end_when_the_supervisor_is_killed(tmp_path: Path) -> None:
    """After `kill -9` of the supervisor the kernel ends the child."""
    script = f"""
import os, time
from server.supervision import Child, Supervisor
child = Child(name="c", command=["sleep", "100"], environment=dict(os.environ), is_ready=lambda: True)
Supervisor([child]).start()
open({str(tmp_path / "pid")!r}, "w").write(f"{{child.process.pid}} ")
time.sleep(100)
"""
    supervisor = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT)
    note = tmp_path / "pid"
    wait_until(lambda: note.exists() and note.read_text().endswith(" "), timeout_s=10, what="the child runs")
    child = psutil.Process(int(note.read_text()))
    wait_until(lambda: child.name() == "sleep", timeout_s=5, what="the child is its command")
    supervisor.kill()
    supervisor.wait()
    _, alive = psutil.wait_procs([child], timeout=5)
    assert alive == []
