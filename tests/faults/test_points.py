"""The means of the fault programme: strikes, their accounts, and what is said of a run that failed."""

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import psutil
import psycopg
import pytest

from tests.faults import diagnosis, hooks, points
from tests.faults.points import Strike
from tests.services.installation import Installation
from tests.services.postgresql import PostgresqlServer
from tests.services.processes import Service, wait_until

FAMILY = """
import subprocess, sys, time
children = [subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)", name]) for name in sys.argv[1:]]
print("here", flush=True)
time.sleep(600)
"""
"""A process with one child for every name."""


class Family(Service):
    """A process like a worker's: one child scores, the other one does not."""

    def command(self) -> Sequence[str]:
        """Start two children."""
        return [sys.executable, "-c", FAMILY, points.SCORING_PROGRAM, "pool"]

    def is_ready(self) -> bool:
        """Say whether both children are there."""
        return b"here" in self.log_path.read_bytes()


@pytest.fixture
def family(tmp_path: Path) -> Iterator[Family]:
    """Give a running family."""
    family = Family("family", tmp_path / "family")
    family.start()
    yield family
    family.signal(signal.SIGCONT)
    family.kill()


@pytest.fixture
def faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give a folder in which points can be armed for this process."""
    monkeypatch.setenv(points.FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setattr(points, "_live_points", {"scored", "enqueued", "commit_sent"})
    return tmp_path


@pytest.mark.parametrize("scoring", [True, False])
def test_a_strike_kills_the_children_of_one_kind_that_there_are(family: Family, faults: Path, scoring: bool) -> None:  # noqa: FBT001 - a parameter of the test
    """Who dies is decided at the moment of the strike, and its account names them; then there is nobody left to kill."""
    assert family.process is not None
    children = psutil.Process(family.process.pid).children()
    due = [child.pid for child in children if (points.SCORING_PROGRAM in child.cmdline()) is scoring]
    for killed in (due, []):
        points.arm(faults, "scored", Strike(kill_children_of=family.process.pid, scoring=scoring))
        points.reach("scored")
        assert list(points.strikes(faults, "scored")[-1].killed) == killed
        wait_until(lambda: not any(map(points.is_alive, due)), what="the death of the child")
    assert len(due) == 1
    assert sum(points.is_alive(child.pid) for child in children) == 1


def test_one_process_may_be_struck_twice(faults: Path) -> None:
    """Every strike has an account of its own, the latest last, and strikes once."""
    for about in ("first", "second"):
        points.arm(faults, "enqueued", Strike())
        points.reach("enqueued", about=about)
        points.reach("enqueued", about="not struck")
    assert [struck.about for struck in points.strikes(faults, "enqueued")] == ["first", "second"]
    assert len(set(points.taken_by(faults, "enqueued"))) == 1


def test_a_held_thread_goes_on_when_it_is_let_go(faults: Path) -> None:
    """It stands still for as long as nobody lets it go."""
    points.arm(faults, "enqueued", Strike(hold=True))
    thread = threading.Thread(target=points.reach, args=("enqueued",), daemon=True)
    thread.start()
    wait_until(lambda: points.strikes(faults, "enqueued"), what="the strike")
    assert thread.is_alive()
    points.let_go(points.strikes(faults, "enqueued")[0])
    thread.join()


def test_a_commit_is_struck_before_its_answer(postgresql: PostgresqlServer, faults: Path) -> None:
    """At `commit_sent` the database has made the change, and the one who asked for it does not know yet."""
    place = f"host=127.0.0.1 port={postgresql.port} user=cs3d dbname={postgresql.create_database()}"
    asking, other = psycopg.connect(place), psycopg.connect(place, autocommit=True)
    asking.execute("CREATE TABLE asked ()")
    points.arm(faults, "commit_sent", Strike(hold=True))
    steps = hooks.commit_reaching(asking, "commit_sent")
    thread = threading.Thread(target=asking.wait, args=(steps,), daemon=True)
    thread.start()
    seen = "SELECT FROM pg_class WHERE relname = 'asked'"
    wait_until(lambda: other.execute(seen).rowcount == 1, what="a change that the others see")
    wait_until(lambda: points.strikes(faults, "commit_sent"), what="the strike")
    assert asking.pgconn.transaction_status == psycopg.pq.TransactionStatus.ACTIVE
    points.let_go(points.strikes(faults, "commit_sent")[0])
    thread.join()
    assert asking.pgconn.transaction_status == psycopg.pq.TransactionStatus.IDLE
    other.close()
    asking.close()


@pytest.mark.parametrize("shape", ["embedded"], indirect=True)
def test_a_failed_run_says_how_everything_stands(installation: Installation, family: Family, faults: Path) -> None:
    """Unfinished submissions with their states, armed points, processes that are stopped, and the last lines of logs."""
    submission_id = installation.submit(enqueue=False)
    points.arm(faults, "scored", Strike())
    lines = [f"line {number}" for number in range(diagnosis.LAST_LINES)]
    family.log_path.write_text("\n".join(["a line too many", *lines]))
    assert family.process is not None
    parent = psutil.Process(family.process.pid)
    family.signal(signal.SIGSTOP)
    wait_until(lambda: parent.status() == psutil.STATUS_STOPPED, what="a stopped process")
    said = diagnosis.describe(installation.services, [family], faults)
    assert f"{submission_id} received" in said
    assert "armed points: ['scored']" in said
    assert f"family: {parent.pid} stopped" in said
    assert said.splitlines()[-diagnosis.LAST_LINES :] == lines
    family.kill()
    assert "family: ended" in diagnosis.describe(installation.services, [family], faults)
