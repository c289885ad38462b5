"""Content-Digest and Repr-Digest (RFC 9530): the sender's SHA-256, checked against what arrived."""

import base64
import binascii
import re

from starlette.datastructures import Headers

from server.api.errors import DigestMismatch, MalformedRequest

_MEMBER = re.compile(r"\s*([a-z0-9-]+)\s*=\s*:([A-Za-z0-9+/=]*):\s*")


def announced_sha256(headers: Headers) -> str | None:
    """Read the SHA-256 a request announces for its body.

    Other algorithms are passed over, as RFC 9530 section 2 asks; without content coding both headers mean the same
    bytes.

    Returns:
        The digest in hexadecimal, None when there is none.

    Raises:
        MalformedRequest: A header is not a dictionary of digests, or the two contradict each other.
    """
    found = {digest for name in ("content-digest", "repr-digest") for digest in _sha256_of(headers.getlist(name))}
    if len(found) > 1:
        raise MalformedRequest("Content-Digest and Repr-Digest announce different SHA-256 values.")
    return next(iter(found), None)


def check_sha256(announced: str | None, actual: str) -> None:
    """Raise DigestMismatch when a digest was announced and is another."""
    if announced is not None and announced != actual:
        raise DigestMismatch


def _sha256_of(values: list[str]) -> list[str]:
    members = [member for value in values for member in value.split(",")]
    matches = [_MEMBER.fullmatch(member) for member in members]
    if None in matches:
        raise MalformedRequest("Write the digest as `sha-256=:<base64 of 32 bytes>:` (RFC 9530).")
    return [_decode(match[2]) for match in matches if match is not None and match[1] == "sha-256"]


def _decode(text: str) -> str:
    try:
        digest = base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise MalformedRequest("The sha-256 digest is not base64 (RFC 9530).") from error
    if len(digest) != 32:  # noqa: PLR2004 - the length of a SHA-256
        raise MalformedRequest("The sha-256 digest does not have 32 bytes.")
    return digest.hex()
