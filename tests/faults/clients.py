"""Participants: they send predictions through the public API, again and again until they have an answer."""

import hashlib
import random
import threading
import time
import uuid
from collections import Counter
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import httpx
import msgspec

from server.errors import Unavailable
from tests.faults.deployment import SCARCE, SCARCE_PER_DAY, Deployment
from tests.services.installation import SMALL_CASE
from tests.services.zips import zip_files

PATIENCE_S = 600.0
"""A participant who has no 202 after so long was let down, however slow the machine is."""

BACKLOG = 10
"""With so many submissions on their way participants take twice the time to think, with twice as many five times.

A queue that is longer than workers can do in the time after which the sweeper sends messages again would only grow.
"""

ANSWERED_S = 180.0
"""No request hangs for longer."""

ALLOWED = frozenset({202, 503, 507})
OUT_OF_QUOTA = 429


@dataclass(frozen=True, kw_only=True)
class Sent:
    """What was sent and answered with 202."""

    phase: str
    sha256: str
    valid: bool = True
    doomed: str | None = None
    """The failure code of predictions that are deadly for the scoring process."""


@dataclass(frozen=True, kw_only=True)
class Participant:
    """One who sends again and again."""

    method: str
    phase: str = "test"
    share_with_errors: float = 0.15


PARTICIPANTS = (
    *(Participant(method=f"method-{index}") for index in range(3)),
    # Two who compete for the last of a small quota, and get back what errors cost them.
    *(Participant(method=f"greedy-{index}", phase=SCARCE, share_with_errors=0.8) for index in range(2)),
)


def predictions(chance: random.Random, *, score: float | None = None) -> bytes:
    """Make a submission nobody made before; with `score`: every box has this one."""
    files: dict[str, bytes] = {}
    for path in sorted((SMALL_CASE / "pred").iterdir()):
        document = msgspec.json.decode(path.read_bytes())
        for item in document["objects"]:
            item["score"] = round(chance.uniform(0.1, 1.0), 6) if score is None else score
        files[path.name] = msgspec.json.encode(document)
    return zip_files(files)


BEYOND_ONE = 1.5
"""A score that no box may have."""


class Clients:
    """Several participants at once: a context manager, at whose end everybody finishes what they are sending."""

    def __init__(self, deployment: Deployment, *, seed: int, pause_s: float = 1.0) -> None:
        """Start sending."""
        self.accepted: dict[str, Sent] = {}
        """By the id in the 202."""
        self.statuses: Counter[int] = Counter()
        """Every answer but the cut-off ones."""
        self.unforeseen: list[str] = []
        """Answers that nobody should get."""
        self.unanswered: list[str] = []
        self._deployment = deployment
        self._pause_s = pause_s
        self._stop = threading.Event()
        self._threads = [
            # Daemons: a run that failed does not wait for those who still want an answer.
            threading.Thread(target=self._participate, args=(one, random.Random(f"{seed}-{one.method}")), daemon=True)  # noqa: S311 - a plan, not a secret
            for one in PARTICIPANTS
        ]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> Self:
        """Give the participants."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Let everybody finish what they are sending; nobody waits for that when the run has failed."""
        self._stop.set()
        for thread in self._threads if error is None else ():
            thread.join()

    def send_deadly(self, score: float, code: str) -> str:
        """Send predictions that end every process that scores them; return the id."""
        one = Participant(method="deadly")
        data = predictions(random.Random(), score=score)  # noqa: S311 - not used
        submission_id = self._send(data, one)
        if submission_id is None:
            message = f"nobody took the predictions that lead to {code}"
            raise TimeoutError(message)
        self._keep(submission_id, data, one, doomed=code)
        return submission_id

    def _participate(self, one: Participant, chance: random.Random) -> None:
        try:
            self._send_again_and_again(one, chance)
        except Exception as error:  # noqa: BLE001 - whatever ends a participant is told with the verdict
            self.unforeseen.append(f"{one.method} gave up: {error!r}")

    def _send_again_and_again(self, one: Participant, chance: random.Random) -> None:
        while not self._stop.wait(self._pause_s * (1 + (self._unfinished() / BACKLOG) ** 2)):
            valid = chance.random() >= one.share_with_errors
            # Nobody sends the same bytes twice: what the sender says is then checked against one row.
            data = predictions(chance) if valid else predictions(chance, score=BEYOND_ONE + chance.random())
            submission_id = self._send(data, one)
            if submission_id:
                self._keep(submission_id, data, one, valid=valid)

    def _unfinished(self) -> int:
        """Count what waits, so that participants do not outrun the workers of a slow machine."""
        try:
            return len(self._deployment.unfinished())
        except Unavailable:
            return 0

    def _keep(
        self, submission_id: str, data: bytes, one: Participant, *, valid: bool = True, doomed: str | None = None
    ) -> None:
        digest = hashlib.sha256(data).hexdigest()
        self.accepted[submission_id] = Sent(phase=one.phase, sha256=digest, valid=valid, doomed=doomed)

    def _send(self, data: bytes, one: Participant) -> str | None:
        """Send until there is a 202 or the quota is used up; the key makes the repetitions one submission."""
        key = uuid.uuid4().hex
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            answer = self._post(data, one, key)
            if answer is not None and answer.status_code == httpx.codes.ACCEPTED:
                return str(answer.json()["id"])
            if answer is not None and answer.status_code == OUT_OF_QUOTA and one.phase == SCARCE:
                return None
            time.sleep(0.3)
        self.unanswered.append(key)
        return None

    def _post(self, data: bytes, one: Participant, key: str) -> httpx.Response | None:
        headers = {
            "Authorization": f"Bearer {self._deployment.token}", "Content-Type": "application/zip",
            "Idempotency-Key": key,
        }  # fmt: skip
        place = {"benchmark": "cs3d", "phase": one.phase, "method": one.method}
        url = f"{self._deployment.web.url}/api/v1/submissions"
        try:
            answer = httpx.post(url, params=place, headers=headers, content=data, timeout=ANSWERED_S)
        except httpx.ReadTimeout:
            self.unforeseen.append(f"no answer within {ANSWERED_S:g} s")
            return None
        except httpx.TransportError:  # the web process was killed, or is not there
            return None
        self.statuses[answer.status_code] += 1
        if answer.status_code not in ALLOWED | ({OUT_OF_QUOTA} if one.phase == SCARCE else set()):
            self.unforeseen.append(f"{answer.status_code} {answer.text}")
        return answer


def valid_beyond_quota(clients: Clients) -> int:
    """Count by how many the valid submissions to the scarce phase exceed its quota."""
    taken = sum(sent.phase == SCARCE and sent.valid for sent in clients.accepted.values())
    return max(0, taken - SCARCE_PER_DAY)
