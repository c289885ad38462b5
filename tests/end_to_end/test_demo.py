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

from tests.end_to_end.browser import Visitor, browsing, chromium
from tests.services.processes import free_port, wait_until

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


@contextmanager
def _serving(data_dir: Path, port: int, output: Path) -> Iterator[str]:
    """Start the demo without --exit; give what it said when it serves; end it as Ctrl-C does."""
    with output.open("w") as stream:
        command = [*ADMIN, "demo", "--data-dir", str(data_dir), "--port", str(port)]
        demo = subprocess.Popen(command, cwd=ROOT, stdout=stream, stderr=stream)
        try:
            wait_until(lambda: "Ctrl-C stops" in output.read_text(), timeout_s=120, what="the demo serves")
            yield output.read_text()
        finally:
            demo.send_signal(signal.SIGINT)
            assert demo.wait(60) == 0


def test_a_second_start_finds_its_data_and_serves_until_it_is_stopped(
    first_run: dict[str, Any], data_dir: Path, tmp_path: Path
) -> None:
    """On a port that is taken it uses another; the submissions are the same; `cs3d submit` works; Ctrl-C ends all."""
    with _port_taken() as port, _serving(data_dir, port, tmp_path / "output") as said:
        assert f"Port {port} is taken" in said
        assert first_run["login"]["password"] in said
        _submit_again(said, data_dir)
        assert len(_processes_of(data_dir)) >= 4  # broker, web, worker and its pool
    assert _processes_of(data_dir) == []


def test_the_leaderboard_shows_how_far_it_can_be_trusted(tmp_path: Path) -> None:
    """Once the worker has resampled the images, each mDS has its interval: the picture in the README."""
    chromium()
    serving = _serving(tmp_path / "data", free_port(), tmp_path / "output")
    with serving as said, browsing(_url(said)) as visitor:
        wait_until(lambda: _intervals(visitor) == 3, timeout_s=300, what="three scores are resampled")
        assert visitor.page.get_by_role("link", name="Compare").is_visible()
        visitor.screenshot("leaderboard", down_to=visitor.page.get_by_role("table").first)


def _intervals(visitor: Visitor) -> int:
    """Open the demo's leaderboard and count the intervals below its scores, such as 59.0-75.7 with a long dash."""
    visitor.open("/benchmarks/cityscapes3d/test")
    visitor.page.wait_for_timeout(500)
    return len(re.findall(r"\b\d+\.\d\N{EN DASH}\d+\.\d\b", visitor.page.get_by_role("table").first.inner_text()))


def _url(said: str) -> str:
    """Read where the demo serves."""
    found = re.search(r"Serving (http://127\.0\.0\.1:\d+)", said)
    assert found is not None
    return found[1]


def _submit_again(said: str, data_dir: Path) -> None:
    """Send one of the demo's zips as a method of its own and wait for the scores."""
    tokens = json.loads((data_dir / "demo.json").read_text())["tokens"]
    archive = data_dir / "synthetic" / "val" / "mono-lift.zip"
    target = ["--benchmark", "cityscapes3d", "--phase", "val", "--method", "copy"]
    done = subprocess.run(
        [sys.executable, "-m", "client.main", "submit", str(archive), *target, "--check", "--wait", "--json"],
        cwd=ROOT,
        env={**os.environ, "CS3D_SERVER": _url(said), "CS3D_TOKEN": tokens["borealis"]},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    submission = json.loads(done.stdout)
    assert submission["state"] == "scored"
    assert submission["results"]["mds"] == submission["mds"] > 0
