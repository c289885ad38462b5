"""The benchmark server's REST API, as `cs3d submit` and `cs3d watch` use it."""

import base64
import hashlib
import secrets
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx

from evaluator.errors import BenchmarkError, UsageError

BLOCK_BYTES = 1024 * 1024
LONG_POLL_S = 20
TRIES = 4
"""A broken connection is tried again so often in all; the idempotency key keeps that from sending twice."""

FIRST_PAUSE_S = 1.0

_NO_ADDRESS = "--server is no address of a server; write it like https://benchmark.example.org."


class ServerRefused(BenchmarkError):
    """The server did not carry out the request; `document` is its problem document."""

    code = "server_refused"

    def __init__(self, document: dict[str, Any]) -> None:
        """Keep the problem document."""
        self.document = document
        super().__init__(document.get("detail") or document.get("title") or "the server refused")


class ServerUnreachable(BenchmarkError):
    """No connection to the server."""

    code = "server_unreachable"


class Server:
    """One server, spoken to with one token."""

    def __init__(self, url: str, token: str, *, transport: httpx.BaseTransport | None = None) -> None:
        """Prepare to speak; nothing is sent yet.

        Args:
            url: Where the server is, for example `https://benchmark.example.org`.
            token: API token of a team's member.
            transport: Another way to reach it than the network.

        Raises:
            UsageError: These are no address and no token.
        """
        if not (token.isascii() and token.isprintable()):
            raise UsageError("the token has characters that no token has; copy it again from your account page.")
        headers = {"Authorization": f"Bearer {token}", "Accept": "application/json"}
        timeout = httpx.Timeout(60, read=LONG_POLL_S + 60)
        try:
            self._http = httpx.Client(base_url=url.rstrip("/"), headers=headers, timeout=timeout, transport=transport)
        except httpx.InvalidURL as error:
            raise UsageError(_NO_ADDRESS) from error

    def address(self, path: str) -> str:
        """Give the whole address of a path on the server."""
        return f"{str(self._http.base_url).rstrip('/')}{path}"

    def submit(self, archive: Path, fields: dict[str, str], sent: Callable[[int], None]) -> dict[str, Any]:
        """Upload a zip.

        Args:
            archive: The zip of prediction files.
            fields: benchmark, phase, method and, if wanted, what is shown of the method: method_name, description,
                paper_url, code_url.
            sent: Called with the number of bytes sent so far.

        Returns:
            The submission as the server describes it.
        """
        headers = {
            "Content-Type": "application/zip",
            "Content-Length": str(archive.stat().st_size),
            "Content-Digest": f"sha-256=:{_digest(archive)}:",
            "Idempotency-Key": secrets.token_urlsafe(24),
        }
        params = {**fields, "file_name": archive.name}

        def send() -> httpx.Response:
            return self._http.post(
                "/api/v1/submissions", params=params, headers=headers, content=_blocks(archive, sent)
            )

        return _checked(_persistently(send), "id", "links")

    def images(self, benchmark: str, phase: str) -> bytes:
        """Fetch which images a phase has, with their cameras: an `ImageList` as JSON."""
        path = "/".join(quote(slug, safe="") for slug in (benchmark, phase))
        answer = _persistently(lambda: self._http.get(f"/api/v1/benchmarks/{path}/images"))
        _checked(answer, "images", "intrinsics_px", "sensor_from_vehicle")
        return answer.content

    def follow(self, submission_id: str) -> Iterator[dict[str, Any]]:
        """Yield the submission now and after every change, until nothing changes by itself any more."""
        etag = ""
        while True:
            answer = _persistently(partial(self._show, submission_id, etag))
            if answer.status_code == httpx.codes.NOT_MODIFIED:
                continue
            document = _checked(answer, "state", "terminal")
            etag = answer.headers.get("ETag", "")
            yield document
            if document["terminal"]:
                return

    def _show(self, submission_id: str, etag: str) -> httpx.Response:
        """Ask for a submission; with an ETag, the answer comes once it has changed."""
        waiting = {"If-None-Match": etag} if etag else {}
        return self._http.get(
            f"/api/v1/submissions/{submission_id}", params={"wait": LONG_POLL_S if etag else 0}, headers=waiting
        )

    def results(self, submission_id: str) -> bytes:
        """Fetch the scores of a scored submission as JSON."""
        answer = _persistently(lambda: self._http.get(f"/api/v1/submissions/{submission_id}/results"))
        _checked(answer, "signature", "classes")
        return answer.content


def _digest(archive: Path) -> str:
    """Return the base64 of a file's SHA-256."""
    with archive.open("rb") as stream:
        return base64.b64encode(hashlib.file_digest(stream, "sha256").digest()).decode()


def _blocks(archive: Path, sent: Callable[[int], None]) -> Iterator[bytes]:
    """Read a file block by block, telling how far it is."""
    done = 0
    with archive.open("rb") as stream:
        while block := stream.read(BLOCK_BYTES):
            yield block
            done += len(block)
            sent(done)


def _persistently(ask: Callable[[], httpx.Response]) -> httpx.Response:
    """Ask, and ask again when the connection breaks or the server is overloaded.

    Raises:
        ServerUnreachable: It never worked.
        UsageError: It cannot work.
    """
    pause_s = FIRST_PAUSE_S
    for remaining in reversed(range(TRIES)):
        try:
            answer = ask()
        except httpx.UnsupportedProtocol as error:
            raise UsageError(_NO_ADDRESS) from error
        except httpx.TransportError as error:
            if not remaining:
                message = f"cannot reach the server ({error!r}); check --server and the connection"
                raise ServerUnreachable(message) from error
        else:
            if answer.status_code != httpx.codes.SERVICE_UNAVAILABLE or not remaining:
                return answer
        time.sleep(pause_s)
        pause_s *= 2
    raise ServerUnreachable("cannot reach the server")


def _checked(answer: httpx.Response, *expected: str) -> dict[str, Any]:
    """Return the JSON object of a good answer, which has the expected keys.

    Raises:
        ServerRefused: It is not a good answer, or not one of a benchmark server.
    """
    try:
        document = answer.json()
    except ValueError:
        document = None
    is_object = isinstance(document, dict)
    if answer.is_success and is_object and document.keys() >= set(expected):
        return dict(document)
    if not answer.is_success and is_object:
        raise ServerRefused(document)
    said = f"{answer.status_code} {answer.reason_phrase}"
    detail = f"no answer of a benchmark server, check --server: {said}: {answer.text[:300]}"
    raise ServerRefused({"title": said, "detail": detail})
