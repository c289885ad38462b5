"""Participants: they send predictions through the public API, again and again until they have an answer."""

import random
import threading
import time
import uuid
from collections import Counter
from pathlib import Path

import httpx
import msgspec

from tests.faults.deployment import Deployment
from tests.services.installation import SMALL_CASE
from tests.services.zips import zip_files

SHARE_WITH_ERRORS = 0.15
PATIENCE_S = 60.0


def predictions(chance: random.Random, *, with_errors: bool) -> bytes:
    """Make a submission nobody made before; with errors: one score is beyond 1."""
    files: dict[str, bytes] = {}
    for path in sorted((SMALL_CASE / "pred").iterdir()):
        document = msgspec.json.decode(path.read_bytes())
        for item in document["objects"]:
            item["score"] = 1.5 if with_errors else round(chance.uniform(0.1, 1.0), 6)
        files[path.name] = msgspec.json.encode(document)
    return zip_files(files)


def post(deployment: Deployment, data: bytes, *, method: str, key: str) -> httpx.Response:
    """Send one submission, once.

    Raises:
        httpx.TransportError: The connection broke or the server was not there.
    """
    headers = {
        "Authorization": f"Bearer {deployment.token}", "Content-Type": "application/zip", "Idempotency-Key": key,
    }  # fmt: skip
    place = {"benchmark": "cs3d", "phase": "test", "method": method}
    url = f"{deployment.web.url}/api/v1/submissions"
    return httpx.post(url, params=place, headers=headers, content=data, timeout=45)


def send_one(deployment: Deployment, method: str) -> str:
    """Send one valid submission in calm weather and return its id."""
    answer = post(deployment, predictions(random.Random(method), with_errors=False), method=method, key=method)  # noqa: S311 - a plan, not a secret
    return str(answer.raise_for_status().json()["id"])


class Clients:
    """Several participants at once, until they are told to stop."""

    def __init__(self, deployment: Deployment, *, seed: int, count: int = 3, pause_s: float = 1.0) -> None:
        """Start sending."""
        self.accepted: dict[str, bool] = {}
        """Id of every 202 -> whether its predictions have errors."""
        self.statuses: Counter[int] = Counter()
        """Every answer but the cut-off ones."""
        self.cut_off = 0
        """Requests whose connection broke: the web process was killed."""
        self.slowest_s = 0.0
        self.unanswered: list[str] = []
        self._deployment = deployment
        self._pause_s = pause_s
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self._participate, args=(random.Random(f"{seed}-{index}"), f"method-{index}"))  # noqa: S311 - a plan, not a secret
            for index in range(count)
        ]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Let everybody finish what they are sending."""
        self._stop.set()
        for thread in self._threads:
            thread.join()

    def _participate(self, chance: random.Random, method: str) -> None:
        while not self._stop.wait(self._pause_s):
            with_errors = chance.random() < SHARE_WITH_ERRORS
            data = predictions(chance, with_errors=with_errors)
            submission_id = self._send(data, method)
            if submission_id:
                self.accepted[submission_id] = with_errors

    def _send(self, data: bytes, method: str) -> str | None:
        """Send until there is a 202; the key makes the repetitions one submission."""
        key = uuid.uuid4().hex
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            began_s = time.monotonic()
            answer = self._post(data, method, key)
            if answer is not None and answer.status_code == httpx.codes.ACCEPTED:
                self.slowest_s = max(self.slowest_s, time.monotonic() - began_s)
                return str(answer.json()["id"])
            time.sleep(0.3)
        self.unanswered.append(key)
        return None

    def _post(self, data: bytes, method: str, key: str) -> httpx.Response | None:
        deployment = self._deployment
        try:
            answer = post(deployment, data, method=method, key=key)
        except httpx.TransportError:
            self.cut_off += 1
            return None
        self.statuses[answer.status_code] += 1
        if answer.status_code >= httpx.codes.INTERNAL_SERVER_ERROR:
            _note(deployment.faults.parent / "answers.log", answer)
        return answer


def _note(path: Path, answer: httpx.Response) -> None:
    with path.open("a") as log:
        log.write(f"{answer.status_code} {answer.text}\n")
