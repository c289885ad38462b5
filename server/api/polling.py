"""Cheap answers for those who ask again: a submission's status, rendered once, sent until something about it changes.

Polling is most of what a benchmark server answers. An answer kept here is sent again only when the database says, at
that moment, that everything it was made from is as it was: the token still opens the submission, and the submission,
its phase and its scores are the same. However many clients ask at a time, one query finds that out for all of them;
those who come while it runs share the next one, so nobody is shown less than what was committed when they asked.

Everything else - no token, a first time, something changed, a query string, an error - goes the ordinary way.
"""

import asyncio
import hashlib
import time
import uuid
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import sqlalchemy as sa
import structlog
from fastapi import FastAPI
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.types import Message, Receive, Scope, Send

from server import database
from server.models import Membership, Phase, Score, Submission, Token, User
from server.security import headers_of
from server.services import Services

log = structlog.get_logger(__name__)

COLLECT_S = 0.005
"""Between two queries: under load more of those who ask share one; who asks alone is not kept waiting."""
MAX_ANSWERS = 2048
MAX_ANSWER_BYTES = 16 << 10
"""Larger answers, with long reports, are rendered every time: what is kept stays within 32 MiB."""
MAX_AGE_S = 60.0
"""The basis does not hold the names of methods and teams, so that a changed one shows after so long at the latest."""

Basis = tuple[object, ...]
"""What an answer was made from; equal again: the answer is still right."""

Key = tuple[str, str]
"""SHA-256 of a token, and the submission's id as the server writes it."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One rendered status for one token."""

    basis: Basis
    etag: str
    full: Response
    unchanged: Response
    """The answer 304 for who holds this version already."""
    made_s: float = field(default_factory=time.monotonic)

    @cached_property
    def messages(self) -> dict[tuple[str, bool], tuple[Message, Message]]:
        """What ASGI is sent, complete with the security headers: by scheme, and whether the version is held already."""
        return {
            (scheme, held): _messages(self.unchanged if held else self.full, scheme)
            for scheme in ("http", "https")
            for held in (False, True)
        }


def _messages(response: Response, scheme: str) -> tuple[Message, Message]:
    start: Message = {
        "type": "http.response.start",
        "status": response.status_code,
        "headers": [*response.raw_headers, *headers_of(scheme)],
    }
    return start, {"type": "http.response.body", "body": response.body}


@dataclass(slots=True)
class _Question:
    """One query for everybody who asks at about the same time."""

    keys: set[Key] = field(default_factory=set)
    bases: dict[Key, Basis] = field(default_factory=dict)
    """Missing: the token opens nothing, or there is no such submission, or the database is away."""
    answered: asyncio.Event = field(default_factory=asyncio.Event)


class Polls:
    """The answers that one web process keeps."""

    def __init__(self, services: Services) -> None:
        """Ask the database of `services`."""
        self._services = services
        self._answers: dict[Key, Answer] = {}
        self._next: _Question | None = None
        self._asking: asyncio.Task[None] | None = None

    def keep(self, key: Key, answer: Answer) -> None:
        """Keep an answer, in the place of the oldest one when there are too many."""
        self._answers.pop(key, None)
        if len(answer.full.body) > MAX_ANSWER_BYTES:
            return
        while len(self._answers) >= MAX_ANSWERS:
            del self._answers[next(iter(self._answers))]
        self._answers[key] = answer

    async def again(self, key: Key) -> Answer | None:
        """Give the answer for a token and a submission once more; None when there is none that is still right."""
        answer = self._answers.get(key)
        if answer is None or time.monotonic() - answer.made_s > MAX_AGE_S:
            return None
        return answer if await self._basis(key) == answer.basis else None

    async def _basis(self, key: Key) -> Basis | None:
        if self._next is None:
            self._next = _Question()
        question = self._next
        question.keys.add(key)
        if self._asking is None:
            self._asking = asyncio.create_task(self._ask())
        await question.answered.wait()
        return question.bases.get(key)

    async def _ask(self) -> None:
        """Ask one question after the other until nobody waits."""
        try:
            while self._next is not None:
                question, self._next = self._next, None
                try:
                    question.bases = await run_in_threadpool(self._look, question.keys)
                except Exception as error:  # noqa: BLE001 - whatever it is, the ordinary way meets it again and tells
                    log.warning("poll_failed", error=repr(error))
                finally:
                    question.answered.set()
                await asyncio.sleep(COLLECT_S)
        finally:
            self._asking = None

    def _look(self, keys: set[Key]) -> dict[Key, Basis]:
        with self._services.snapshot() as session:
            return bases_of(session, keys)


def key_of(token: str, submission_id: str) -> Key:
    """Name an answer without keeping the token's secret."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest(), submission_id


def bases_of(session: Session, keys: Iterable[Key]) -> dict[Key, Basis]:
    """Read what answers are made from, of all keys at once.

    A key is missing from the result when its token is not good (`accounts.authenticate_token` says what that means)
    or there is no such submission. A token that is good may still not open the submission: whether it does follows
    from the basis, as it did when the answer was made.
    """
    pairs = [(digest, uuid.UUID(submission_id)) for digest, submission_id in keys]
    tokens = _good_tokens(session, {digest for digest, _ in pairs})
    submissions = _submissions(session, {submission_id for _, submission_id in pairs})
    return {
        (digest, str(submission_id)): (*tokens[digest], *submissions[submission_id])
        for digest, submission_id in pairs
        if digest in tokens and submission_id in submissions
    }


# Made once: composing a statement takes longer than running it.
_GOOD_TOKENS = (
    sa.select(Token.secret_sha256, Token.expires_at, Token.id, Token.team_id, User.id, User.is_maintainer)
    .join(User, User.id == Token.user_id)
    .join(Membership, (Membership.team_id == Token.team_id) & (Membership.user_id == Token.user_id))
    .where(Token.secret_sha256.in_(sa.bindparam("digests", expanding=True)))
    .where(Token.revoked_at.is_(None), User.disabled_at.is_(None))
)

_SUBMISSIONS = (
    sa.select(
        Submission.id,
        Submission.version,
        Submission.stage,
        Submission.images_done,
        Phase.protocol,
        Phase.ground_truth_id,
        sa.select(sa.func.max(Score.id)).where(Score.submission_id == Submission.id).scalar_subquery(),
    )
    .join(Phase, Phase.id == Submission.phase_id)
    .where(Submission.id.in_(sa.bindparam("ids", expanding=True)))
)


def _good_tokens(session: Session, digests: set[str]) -> dict[str, Basis]:
    rows = session.connection().execute(_GOOD_TOKENS, {"digests": list(digests)}).all()
    at = database.now(session) if any(row.expires_at for row in rows) else None
    good = [row for row in rows if at is None or row.expires_at is None or row.expires_at > at]
    return {row.secret_sha256: tuple(row)[2:] for row in good}


def _submissions(session: Session, submission_ids: set[uuid.UUID]) -> dict[uuid.UUID, Basis]:
    rows = session.connection().execute(_SUBMISSIONS, {"ids": list(submission_ids)})
    return {row[0]: tuple(row)[1:] for row in rows}


class AnswersRepeatedPolls(FastAPI):
    """An application that answers those who ask again before anything else is done, its own middleware included."""

    polls: Polls
    polled: str
    """Statuses are at `<polled><id>`."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the kept answer, or handle the request in the ordinary way."""
        answer = await self._again(scope) if _is_poll(scope, self.polled) else None
        if answer is None:
            await super().__call__(scope, receive, send)
            return
        for message in answer:
            await send(message)

    async def _again(self, scope: Scope) -> tuple[Message, Message] | None:
        headers = _first_of_each(scope["headers"])
        kind, _, token = headers.get(b"authorization", b"").decode("latin-1").partition(" ")
        if kind.lower() != "bearer":
            return None
        answer = await self.polls.again(key_of(token.strip(), scope["path"][len(self.polled) :]))
        if answer is None:
            return None
        known = headers.get(b"if-none-match")
        held = known is not None and names_version(known.decode("latin-1"), answer.etag)
        # A proxy may say any scheme, `wss` among them; only https has headers of its own.
        return answer.messages["https" if scope["scheme"] == "https" else "http", held]


def _is_poll(scope: Scope, polled: str) -> bool:
    return bool(
        scope["type"] == "http"
        and scope["method"] == "GET"
        and scope["path"].startswith(polled)
        and not scope["query_string"]
    )


def _first_of_each(headers: Iterable[tuple[bytes, bytes]]) -> dict[bytes, bytes]:
    """Give the value of every header; of one that comes several times the first, as Starlette does."""
    return dict(reversed(list(headers)))


def names_version(if_none_match: str, etag: str) -> bool:
    """Tell whether If-None-Match names a version (RFC 9110, section 13.1.2)."""
    known = {value.strip().removeprefix("W/") for value in if_none_match.split(",")}
    return etag in known or "*" in known
