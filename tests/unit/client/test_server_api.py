"""What `cs3d submit` and `cs3d watch` say to a server, and how they take its answers."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from client import server_api
from client.server_api import Server, ServerRefused, ServerUnreachable
from evaluator.errors import UsageError

Answer = Callable[[httpx.Request], httpx.Response]

RECEIVED = {"id": "1", "links": {"page": "/submissions/1"}}


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Try again at once."""
    monkeypatch.setattr(server_api, "FIRST_PAUSE_S", 0.0)


def _server(answer: Answer) -> Server:
    return Server("http://server.example/", "cs3d_secret", transport=httpx.MockTransport(answer))


def test_a_zip_is_sent_raw_with_its_digest(tmp_path: Path) -> None:
    """The body is the file; fields are in the query; the digest of b"zip" is known."""
    archive = tmp_path / "ours.zip"
    archive.write_bytes(b"zip")
    seen: list[httpx.Request] = []
    sent: list[int] = []

    def answer(request: httpx.Request) -> httpx.Response:
        request.read()
        seen.append(request)
        return httpx.Response(202, json=RECEIVED)

    assert _server(answer).submit(archive, {"phase": "test"}, sent.append) == RECEIVED
    (request,) = seen
    assert request.content == b"zip"
    assert dict(request.url.params) == {"phase": "test", "file_name": "ours.zip"}
    assert request.headers["Authorization"] == "Bearer cs3d_secret"
    # printf zip | openssl dgst -sha256 -binary | base64
    assert request.headers["Content-Digest"] == "sha-256=:SnD+mqZDbgLC3qNA+9HjUuTvLYzmylKtJdS5VHH8i/I=:"
    assert sent == [3]


def test_a_broken_connection_is_tried_again_with_the_same_key(tmp_path: Path) -> None:
    """The second try carries the first one's idempotency key, so nothing is sent twice."""
    archive = tmp_path / "ours.zip"
    archive.write_bytes(b"zip")
    keys: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        keys.append(request.headers["Idempotency-Key"])
        if len(keys) == 1:
            raise httpx.ConnectError("refused")
        return httpx.Response(202, json=RECEIVED)

    _server(answer).submit(archive, {}, lambda _: None)
    assert len(keys) == 2
    assert keys[0] == keys[1]


def test_a_server_that_never_answers_is_unreachable() -> None:
    """After four tries the error names the option to check."""
    tries: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        tries.append(request.url.path)
        raise httpx.ConnectError("refused")

    with pytest.raises(ServerUnreachable, match="--server"):
        _server(answer).results("1")
    assert len(tries) == 4


def test_a_problem_document_becomes_an_error() -> None:
    """The error's text is the detail, and the whole document stays at hand."""
    problem = {"title": "Too many.", "detail": "Try again tomorrow.", "code": "quota_exceeded"}
    server = _server(lambda _: httpx.Response(429, json=problem))
    with pytest.raises(ServerRefused, match=r"Try again tomorrow\.") as refusal:
        server.results("1")
    assert refusal.value.document["code"] == "quota_exceeded"


def test_an_answer_that_is_not_json_is_shown() -> None:
    """A proxy's page becomes an error with its status."""
    with pytest.raises(ServerRefused, match="Bad gateway page"):
        _server(lambda _: httpx.Response(502, text="Bad gateway page")).results("1")


@pytest.mark.parametrize(
    ("status", "text"),
    [(200, '{"x": 1}'), *((status, text) for status in (200, 502) for text in ("<html>", '"bad"', "[]", "null"))],
)
def test_an_answer_of_something_else_is_refused(status: int, text: str, tmp_path: Path) -> None:
    """Whatever stands where a server was expected, its status and its words are shown; nothing is taken for an answer."""
    archive = tmp_path / "ours.zip"
    archive.write_bytes(b"zip")
    server = _server(lambda _: httpx.Response(status, text=text))

    for ask in (
        lambda: next(server.follow("1")),
        lambda: server.results("1"),
        lambda: server.submit(archive, {}, print),
    ):
        with pytest.raises(ServerRefused) as refusal:
            ask()
        assert f"check --server: {status}" in str(refusal.value)
        assert str(refusal.value).endswith(text)


@pytest.mark.parametrize("url", ["localhost:9", "ftp://server.example", "http://server\n.example"])
def test_what_is_no_address_is_wrong_usage(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is said at once, without another try."""
    monkeypatch.setattr(server_api, "TRIES", 1)

    with pytest.raises(UsageError, match="--server"):
        Server(url, "cs3d_secret").results("1")


@pytest.mark.parametrize("token", ["ä", "cs3d_x\n"])
def test_what_is_no_token_is_wrong_usage(token: str) -> None:
    """A header could not hold it."""
    with pytest.raises(UsageError, match="token"):
        Server("http://server.example", token)


def test_following_waits_for_changes_until_the_end() -> None:
    """Each change is yielded once: 304 yields nothing, and the terminal state ends it."""
    states = ["received", None, "scoring", "scored"]
    asked: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        state = states[len(asked)]
        asked.append(request.headers.get("If-None-Match", ""))
        if state is None:
            return httpx.Response(304)
        body: dict[str, Any] = {"state": state, "terminal": state == "scored"}
        return httpx.Response(200, content=json.dumps(body), headers={"ETag": f'"{state}"'})

    assert [document["state"] for document in _server(answer).follow("1")] == ["received", "scoring", "scored"]
    assert asked == ["", '"received"', '"received"', '"scoring"']
