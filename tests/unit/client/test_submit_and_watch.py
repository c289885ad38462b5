"""What `cs3d submit` and `cs3d watch` print, and how they exit."""

import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from client import submit
from client.main import main
from client.server_api import Server
from client.watch import conclude

SUBMIT = ["submit", "ours.zip", "--benchmark", "cs3d", "--phase", "test", "--method", "ours"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (SUBMIT, "CS3D_SERVER"),
        ([*SUBMIT, "--server", "http://server.example"], "CS3D_TOKEN"),
        ([*SUBMIT, "--server", "http://server.example", "--token", "cs3d_x"], "is not a file"),
        (["watch", "1"], "CS3D_SERVER"),
    ],
)
def test_what_is_missing_is_wrong_usage(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Exit status 2, and the message names the option or variable to give."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CS3D_SERVER", raising=False)
    monkeypatch.delenv("CS3D_TOKEN", raising=False)
    assert main(arguments) == 2
    assert said in capsys.readouterr().err


def _only_lists_images(request: httpx.Request) -> httpx.Response:
    """Be a server that tells its two images and takes nothing."""
    assert (request.method, request.url.path) == ("GET", "/api/v1/benchmarks/cs3d/test/images")
    images = ["bonn_000000_000019", "bonn_000001_000019"]
    return httpx.Response(200, json={"images": images, "intrinsics_px": [], "sensor_from_vehicle": []})


@pytest.mark.parametrize(
    ("files", "said"),
    [
        (None, ["not_a_zip"]),
        (["bonn_000000_000019_pred.json"], ["missing_image", "bonn_000001_000019_<anything>.json"]),
        (
            ["bonn_000000_000019_pred.json", "bonn_000007_000019_pred.json"],
            ["unknown_image", "bonn_000007_000019_pred"],
        ),
    ],
)
def test_what_has_errors_is_not_sent(
    files: list[str] | None,
    said: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With --check the server is asked for the phase's images; what has errors exits with 1 and is not sent."""
    archive = tmp_path / "ours.zip"
    archive.write_text("no zip")
    if files is not None:
        with zipfile.ZipFile(archive, "w") as opened:
            for name in files:
                opened.writestr(name, '{"objects": []}')
    server = Server("http://server.example", "cs3d_x", transport=httpx.MockTransport(_only_lists_images))
    monkeypatch.setattr(submit, "connect", lambda _: server)
    assert main(["submit", str(archive), *SUBMIT[2:], "--check"]) == 1
    printed = capsys.readouterr().err
    assert all(part in printed for part in said)


class _FinishedServer(Server):
    """A server on which a submission has just ended."""

    def __init__(self, document: dict[str, Any]) -> None:
        self._document = document

    def follow(self, submission_id: str) -> Iterator[dict[str, Any]]:
        """Yield the end."""
        del submission_id
        yield self._document


REPORT = {
    "groups": [
        {
            "code": "missing_image",
            "severity": "error",
            "title": "An image has no prediction file.",
            "fix": "Add a file for it.",
            "count": 1,
            "problems": [{"expected": "bonn_000000_000019_<anything>.json"}],
        }
    ],
    "images_expected": 2,
    "images_found": 1,
    "boxes": 7,
}


def test_a_rejected_submission_prints_its_report(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit status 1; code, place and fix are on stderr."""
    server = _FinishedServer({"state": "rejected", "terminal": True, "report": REPORT, "failure": None})
    assert conclude(server, "1", as_json=False) == 1
    said = capsys.readouterr().err
    assert all(part in said for part in ("missing_image", "bonn_000000_000019_", "Add a file for it."))


def test_a_failed_submission_prints_its_cause(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit status 1; with --json the whole submission is on stdout, without results."""
    failure = {"code": "attempts_exhausted", "detail": "three workers were lost"}
    document = {"state": "failed", "terminal": True, "report": None, "failure": failure}
    assert conclude(_FinishedServer(document), "1", as_json=False) == 1
    assert "attempts_exhausted: three workers were lost" in capsys.readouterr().err
    assert conclude(_FinishedServer(document), "1", as_json=True) == 1
    assert json.loads(capsys.readouterr().out) == {**document, "results": None}
