"""The demo's participants: they use the public REST API with tokens, as anybody would."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from evaluator.synthetic import QUALITIES, Quality
from server.admin.demo_benchmark import BENCHMARK, PHASES, TEAMS, DemoPhase, Logins, archive
from server.errors import Unavailable
from server.services import Services

POLL_S = 0.25
LONGEST_WAIT_S = 300.0


@dataclass(kw_only=True)
class Upload:
    """One method's submission to one phase."""

    phase: DemoPhase
    method: Quality
    token: str
    predictions: Path
    document: dict[str, Any] | None = None
    """The submission as the API last showed it; None before it is sent."""

    @property
    def state(self) -> str:
        """Name what happens to it now."""
        return self.document["state"] if self.document else "uploading"

    @property
    def done(self) -> bool:
        """True when nothing happens to it by itself any more."""
        return self.document is not None and bool(self.document["terminal"])

    @property
    def share_done(self) -> float:
        """Tell how far it is, in [0, 1]: the first half is validation, the second scoring."""
        if self.done:
            return 1.0
        progress = self.document and self.document["progress"]
        if not progress or not progress["images_total"]:
            return 0.0
        share: float = progress["images_done"] / progress["images_total"] / 2
        return share if progress["stage"] == "validating" else 0.5 + share


def plan(services: Services, logins: Logins) -> list[Upload]:
    """Pair every method with every phase, and make the zips."""
    return [
        Upload(
            phase=phase,
            method=method,
            token=logins.tokens[TEAMS[method.name][0]],
            predictions=archive(services, phase, method.name),
        )
        for phase in PHASES
        for method in QUALITIES
    ]


def send(client: httpx.Client, uploads: list[Upload], each_time: Callable[[], None]) -> None:
    """Send every zip, calling `each_time` in between."""
    for upload in uploads:
        each_time()
        upload.document = _send(client, upload)


def _send(client: httpx.Client, upload: Upload) -> dict[str, Any]:
    """Send one zip and return the submission; the key makes a second start find the first one's."""
    phase, method = upload.phase.slug, upload.method
    with upload.predictions.open("rb") as stream:
        answer = client.post(
            "/api/v1/submissions",
            data={"benchmark": BENCHMARK, "phase": phase, "method": method.name, "method_name": method.title},
            files={"predictions": (upload.predictions.name, stream, "application/zip")},
            headers={**_bearer(upload.token), "Idempotency-Key": f"demo-{phase}-{method.name}"},
        )
    return _checked(answer)


def wait_for(client: httpx.Client, uploads: list[Upload], each_time: Callable[[], None]) -> None:
    """Look at every submission until all are done, calling `each_time` in between.

    Raises:
        Unavailable: It takes too long, or one ends otherwise than scored.
    """
    deadline = time.monotonic() + LONGEST_WAIT_S
    while not all(upload.done for upload in uploads):
        for upload in uploads:
            if upload.document and not upload.done:
                path = f"/api/v1/submissions/{upload.document['id']}"
                upload.document = _checked(client.get(path, headers=_bearer(upload.token)))
        each_time()
        if time.monotonic() > deadline:
            raise Unavailable("the submissions were not scored in time; the log of the worker says why")
        time.sleep(POLL_S)
    each_time()
    for upload in uploads:
        if upload.state != "scored":
            message = f"{upload.method.title} ended as {upload.state}: {upload.document and upload.document['failure']}"
            raise Unavailable(message)


def publish(client: httpx.Client, uploads: list[Upload]) -> None:
    """Publish every submission that nobody has published or withdrawn yet."""
    for upload in uploads:
        if upload.document and upload.document["publication"] == "private":
            path = f"/api/v1/submissions/{upload.document['id']}/publication"
            _checked(client.post(path, json={"publication": "published"}, headers=_bearer(upload.token)))


def leaderboard(client: httpx.Client, phase: str) -> dict[str, Any]:
    """Ask for a phase's leaderboard, as anybody may."""
    return _checked(client.get(f"/api/v1/leaderboards/{BENCHMARK}/{phase}"))


def _bearer(token: str) -> dict[str, str]:
    """Make the header that authenticates."""
    return {"Authorization": f"Bearer {token}"}


def _checked(answer: httpx.Response) -> dict[str, Any]:
    """Return the JSON of a good answer.

    Raises:
        Unavailable: The server refused; its problem document says why.
    """
    if answer.is_error:
        message = f"{answer.request.method} {answer.request.url.path}: {answer.status_code} {answer.text}"
        raise Unavailable(message)
    document: dict[str, Any] = answer.json()
    return document
