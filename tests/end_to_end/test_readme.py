"""The README's way from an empty machine to a running benchmark, carried out as it stands."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions, write_zip
from tests.services.processes import free_port, wait_until

ROOT = Path(__file__).resolve().parents[2]
IMAGES = 5


def _commands() -> list[str]:
    """Read the tested block of the README, without the installation, which is done."""
    (block,) = re.findall(r"<!-- tested -->\n```sh\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    commands: list[str] = block.splitlines()
    assert commands[0] == 'pip install ".[server]"'
    return commands[1:]


def _curl(url: str) -> str:
    """Read the README's curl command, for another method's name and place."""
    (command,) = re.findall(
        r"^(curl --fail-with-body.*?)\n```", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE
    )
    return f"CS3D_SERVER={url}; {command}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty folder with the benchmark's ground truth and a participant's predictions beside it."""
    ground_truth = synthesize_ground_truth(IMAGES, seed=1)
    source = tmp_path / "gtBbox3d" / "test"
    source.mkdir(parents=True)
    for name, content in ground_truth.items():
        (source / name).write_bytes(content)
    write_zip(synthesize_predictions(ground_truth, QUALITIES[0], seed=1), tmp_path / "predictions.zip")
    return tmp_path


@pytest.fixture
def environment() -> dict[str, str]:
    """Our commands on PATH, none of our settings set."""
    scripts = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    clean = {name: value for name, value in os.environ.items() if not name.startswith("CS3D_")}
    return {**clean, "PATH": scripts}


def test_a_real_benchmark_from_an_empty_machine(folder: Path, environment: dict[str, str]) -> None:
    """Every command succeeds; the server takes an upload by curl and scores it; SIGTERM ends it."""
    *setup, serve = _commands()
    printed = ""
    for command in setup:
        done = subprocess.run(
            ["/bin/sh", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{command}: {done.stderr}"
        printed += done.stdout
    (token,) = re.findall(r"cs3d_\S+", printed)
    port = free_port()
    assert serve.startswith("cs3d-admin serve")
    server = subprocess.Popen(
        ["/bin/sh", "-c", "exec " + serve.replace("8000", str(port))], cwd=folder, env=environment
    )
    try:
        _submit_by_curl(f"http://127.0.0.1:{port}", token, folder, environment)
    finally:
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0


def _submit_by_curl(url: str, token: str, folder: Path, environment: dict[str, str]) -> None:
    """Upload the predictions and wait until they are scored."""
    wait_until(lambda: _answers(url), timeout_s=60, what="the server answers")
    done = subprocess.run(
        ["/bin/sh", "-c", _curl(url)],
        cwd=folder,
        env={**environment, "CS3D_TOKEN": token},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (submission_id,) = re.findall(r'"id":\s*"([0-9a-f-]{36})"', done.stdout)
    with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}) as client:
        for _ in range(600):
            document = client.get(f"/api/v1/submissions/{submission_id}").json()
            if document["terminal"]:
                break
            time.sleep(0.1)
        assert document["state"] == "scored"
        assert 0 < document["mds"] <= 1


def _answers(url: str) -> bool:
    try:
        return httpx.get(url).is_success
    except httpx.TransportError:
        return False
