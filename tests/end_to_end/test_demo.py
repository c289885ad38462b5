"""`cs3d-admin demo` as a newcomer runs it, and `cs3d submit` against it."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.services.processes import wait_until

ROOT = Path(__file__).resolve().parents[2]
ADMIN = [sys.executable, "-m", "server.admin.main"]


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for the demo's data, which the tests of this module use one after the other."""
    return tmp_path_factory.mktemp("demo") / "data"


@pytest.fixture(scope="module")
def first_run(data_dir: Path) -> dict[str, Any]:
    """What the demo reports when it runs for the first time."""
    command = [*ADMIN, "demo", "--exit", "--json", "--data-dir", str(data_dir)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    outcome: dict[str, Any] = json.loads(done.stdout)
    return outcome


@contextmanager
def _port_taken() -> Iterator[int]:
    """Listen on a port."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


def _processes_of(data_dir: Path) -> list[psutil.Process]:
    """List the processes that work on a data folder."""
    found = []
    for process in psutil.process_iter():
        try:
            environment = process.environ()
        except psutil.Error:
            continue
        if environment.get("CS3D_DATA_DIR") == str(data_dir):
            found.append(process)
    return found


def test_three_methods_are_ranked_by_quality(first_run: dict[str, Any]) -> None:
    """Through the API, the best imaginary method comes first, with room between them."""
    rows = first_run["leaderboard"]["rows"]
    assert [(row["rank"], row["method"]) for row in rows] == [
        (1, "orthoview-9dof"),
        (2, "mono-lift"),
        (3, "prior-baseline"),
    ]
    best, middle, worst = (row["mds"] for row in rows)
    assert best > middle + 0.1 > worst + 0.2 > 0.2
    assert all(len(row["classes"]) == 6 for row in rows)


def test_no_child_is_left(first_run: dict[str, Any], data_dir: Path) -> None:
    """With --exit every process has ended."""
    assert first_run["leaderboard"]["rows"]
    assert _processes_of(data_dir) == []


def test_a_second_start_finds_its_data_and_serves_until_it_is_stopped(
    first_run: dict[str, Any], data_dir: Path, tmp_path: Path
) -> None:
    """On a port that is taken it uses another; the submissions are the same; `cs3d submit` works; Ctrl-C ends all."""
    output = tmp_path / "output"
    with _port_taken() as port, output.open("w") as stream:
        command = [*ADMIN, "demo", "--data-dir", str(data_dir), "--port", str(port)]
        demo = subprocess.Popen(command, cwd=ROOT, stdout=stream, stderr=stream)
        try:
            wait_until(lambda: "Ctrl-C stops" in output.read_text(), timeout_s=120, what="the demo serves")
            said = output.read_text()
            assert f"Port {port} is taken" in said
            assert first_run["login"]["password"] in said
            _submit_again(said, data_dir)
            assert len(_processes_of(data_dir)) >= 4  # broker, web, worker and its pool
        finally:
            demo.send_signal(signal.SIGINT)
            assert demo.wait(60) == 0
    assert _processes_of(data_dir) == []


def _submit_again(said: str, data_dir: Path) -> None:
    """Send one of the demo's zips as a method of its own and wait for the scores."""
    found = re.search(r"Serving (http://127\.0\.0\.1:\d+)", said)
    assert found is not None
    tokens = json.loads((data_dir / "demo.json").read_text())["tokens"]
    archive = data_dir / "synthetic" / "val" / "mono-lift.zip"
    target = ["--benchmark", "cityscapes3d", "--phase", "val", "--method", "copy"]
    done = subprocess.run(
        [sys.executable, "-m", "client.main", "submit", str(archive), *target, "--check", "--wait", "--json"],
        cwd=ROOT,
        env={**os.environ, "CS3D_SERVER": found[1], "CS3D_TOKEN": tokens["borealis"]},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    submission = json.loads(done.stdout)
    assert submission["state"] == "scored"
    assert submission["results"]["mds"] == submission["mds"] > 0
