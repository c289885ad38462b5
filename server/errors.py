"""What the server refuses, each with its stable code and HTTP status.

    ServerError                500  internal_error
    ├── NotFound               404  not_found
    ├── NotAuthenticated       401  not_authenticated
    ├── Forbidden              403  forbidden
    ├── InvalidField           422  invalid_field
    ├── IdempotencyMismatch    422  idempotency_mismatch
    ├── TooLarge               413  too_large
    ├── Conflict               409  conflict
    │   ├── PhaseClosed        409  phase_closed
    │   ├── NotScored          409  not_scored
    │   ├── Held               409  held_for_review
    │   ├── IllegalTransition  409  illegal_transition
    │   └── LeaseLost          409  lease_lost          a worker's write came too late; never leaves the worker
    │       └── ShardLost      409  shard_lost          the same of a shard
    ├── QuotaExceeded          429  quota_exceeded
    │   └── TooManyRejections  429  too_many_rejections
    ├── Unavailable            503  unavailable
    └── StorageFull            507  storage_full

One handler in the web face renders them as problem documents. Messages name the fix.
"""

from evaluator.errors import BenchmarkError


class ServerError(BenchmarkError):
    """The server does not carry this out; the message says what to do."""


class NotFound(ServerError):
    """There is no such thing, or the asker may not know of it."""

    code = "not_found"
    status = 404


class NotAuthenticated(ServerError):
    """Nobody is logged in, or the token or password is wrong."""

    code = "not_authenticated"
    status = 401


class Forbidden(ServerError):
    """The user is known but may not do this."""

    code = "forbidden"
    status = 403


class InvalidField(ServerError):
    """One value that was sent cannot be used; the message names the field and what it may hold."""

    code = "invalid_field"
    status = 422


class IdempotencyMismatch(ServerError):
    """The Idempotency-Key was used before for another request."""

    code = "idempotency_mismatch"
    status = 422

    def __init__(self) -> None:
        """Say what helps."""
        super().__init__("This Idempotency-Key stands for another submission of yours; use a new key.")


class TooLarge(ServerError):
    """The upload is larger than the server takes."""

    code = "too_large"
    status = 413


class Conflict(ServerError):
    """The request does not fit the present state of things."""

    code = "conflict"
    status = 409


class PhaseClosed(Conflict):
    """The phase takes no submissions now."""

    code = "phase_closed"


class NotScored(Conflict):
    """The submission has no scores (yet)."""

    code = "not_scored"


class Held(Conflict):
    """The submission waits for a maintainer's look at its integrity audit before it may be published."""

    code = "held_for_review"


class IllegalTransition(Conflict):
    """The submission cannot do this in its present state."""

    code = "illegal_transition"


class LeaseLost(Conflict):
    """The worker no longer holds the submission: another attempt, a cancellation or the sweeper took it."""

    code = "lease_lost"


class ShardLost(LeaseLost):
    """The worker no longer holds the shard: another worker took it, or the attempt it belongs to is over."""

    code = "shard_lost"


class QuotaExceeded(ServerError):
    """The team used up its submissions in this phase for now."""

    code = "quota_exceeded"
    status = 429

    def __init__(self, message: str, *, retry_after_s: int | None) -> None:
        """Keep when asking again may help.

        Args:
            message: What is used up and when there will be more.
            retry_after_s: Whole seconds until then, at least 1; None when waiting does not help.
        """
        super().__init__(message)
        self.retry_after_s = retry_after_s


class TooManyRejections(QuotaExceeded):
    """The team sent too many uploads with errors in this phase for now."""

    code = "too_many_rejections"


class Unavailable(ServerError):
    """A service behind the server does not answer; asking again later helps."""

    code = "unavailable"
    status = 503


class StorageFull(ServerError):
    """There is no room to keep the bytes."""

    code = "storage_full"
    status = 507
