"""Passwords are kept as Argon2id hashes. Each takes 0.3 s: keep it off the event loop."""

import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import argon2

from server.errors import InvalidField, Unavailable

FEWEST_CHARACTERS = 10

_AT_ONCE = threading.BoundedSemaphore(4)
"""Each takes 64 MiB and a processor, so logging in must not be a way to take all of either."""
_PATIENCE_S = 5.0


def hashed(password: str) -> str:
    """Hash a new password.

    Raises:
        InvalidField: It is too short.
        Unavailable: Too many passwords are being hashed.
    """
    if len(password) < FEWEST_CHARACTERS:
        message = f"password must have at least {FEWEST_CHARACTERS} characters"
        raise InvalidField(message)
    with _few_at_once():
        return _hasher().hash(password)


def is_right(password: str, known_hash: str | None) -> bool:
    """Tell whether a password is the one that was hashed; without a hash it takes as long and is not.

    Raises:
        Unavailable: Too many passwords are being hashed.
    """
    try:
        with _few_at_once():
            _hasher().verify(known_hash or _hash_of_nothing(), password)
    except argon2.exceptions.VerificationError:
        return False
    return known_hash is not None


@contextmanager
def _few_at_once() -> Iterator[None]:
    if not _AT_ONCE.acquire(timeout=_PATIENCE_S):
        raise Unavailable("too many passwords are being checked at this moment; try again in a few seconds")
    try:
        yield
    finally:
        _AT_ONCE.release()


@cache
def _hasher() -> argon2.PasswordHasher:
    return argon2.PasswordHasher()


@cache
def _hash_of_nothing() -> str:
    """Give a hash that is checked when there is none, so that a wrong e-mail address takes as long as a wrong password."""
    return _hasher().hash(secrets.token_urlsafe(16))
