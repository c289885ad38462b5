"""What only the web face refuses: the transport of an upload, and requests that are not well-formed.

    ServerError                    500  internal_error         server/errors.py
    ├── MalformedRequest           400  malformed_request
    ├── MethodNotAllowed           405  method_not_allowed
    ├── UploadTimeout              408  upload_timeout
    ├── LengthRequired             411  length_required
    ├── UnsupportedMediaType       415  unsupported_media_type
    ├── ValidationFailed           422  invalid_request
    ├── ArchiveRefused             422  archive_refused
    ├── DigestMismatch             422  digest_mismatch
    ├── TooManyRequests            429  too_many_requests
    ├── NotAuthenticated           401  not_authenticated      server/errors.py
    │   └── MissingToken           401  not_authenticated
    ├── Forbidden                  403  forbidden              server/errors.py
    │   └── CsrfFailed             403  csrf_failed
    ├── NotFound                   404  not_found              server/errors.py
    │   └── UnknownPath            404  not_found
    ├── Conflict                   409  conflict               server/errors.py
    │   ├── OffsetConflict         409  offset_mismatch
    │   └── UploadBusy             409  upload_busy
    ├── TooLarge                   413  too_large              server/errors.py
    │   └── UploadTooLarge         413  too_large
    ├── Unavailable                503  unavailable            server/errors.py
    │   └── TooManyUploads         503  too_many_uploads
    │       └── TooManyOwnUploads  503  too_many_own_uploads
    └── StorageFull                507  storage_full           server/errors.py
        └── DiskFull               507  storage_full

Classes of server/errors.py stand here for those that come from them.
"""

import msgspec

from evaluator.report import Report
from server.errors import (
    Conflict,
    Forbidden,
    NotAuthenticated,
    NotFound,
    ServerError,
    StorageFull,
    TooLarge,
    Unavailable,
)


class MalformedRequest(ServerError):
    """The request is not well-formed HTTP, JSON or multipart."""

    code = "malformed_request"
    status = 400


class MissingToken(NotAuthenticated):
    """The request carries no valid token."""

    def __init__(self, message: str = "") -> None:
        """Say how a token is sent."""
        super().__init__(message or "Send an API token in the header `Authorization: Bearer <token>`.")


class CsrfFailed(Forbidden):
    """The form was not sent from a page of this server, or the page is older than the login."""

    code = "csrf_failed"

    def __init__(self) -> None:
        """Say what helps."""
        super().__init__("Reload the page and send the form again.")


class UnknownPath(NotFound):
    """There is nothing at this address."""

    def __init__(self) -> None:
        """Say where to look."""
        super().__init__("There is nothing at this address; /api/v1/openapi.json lists what there is.")


class MethodNotAllowed(ServerError):
    """The address exists, but not for this HTTP method."""

    code = "method_not_allowed"
    status = 405


class UploadTimeout(ServerError):
    """The body came too slowly or stopped coming."""

    code = "upload_timeout"
    status = 408

    def __init__(self) -> None:
        """Point to the upload that survives bad connections."""
        super().__init__("The upload stalled; send it again, or use the resumable upload at /api/v1/uploads.")


class LengthRequired(ServerError):
    """The request announces no body, neither by Content-Length nor by Transfer-Encoding."""

    code = "length_required"
    status = 411

    def __init__(self) -> None:
        """Say how a body is announced."""
        super().__init__("The request has no body; send the archive with Content-Length or Transfer-Encoding: chunked.")


class OffsetConflict(Conflict):
    """The part does not begin where the upload ends."""

    code = "offset_mismatch"

    def __init__(self, *, offset: int) -> None:
        """Say where to go on."""
        super().__init__(f"The upload holds {offset} bytes; send the part that begins at Upload-Offset: {offset}.")
        self.offset = offset


class UploadBusy(Conflict):
    """Another request is writing to this upload."""

    code = "upload_busy"

    def __init__(self) -> None:
        """Say what helps."""
        super().__init__("Another request is still writing to this upload; ask for its offset, then go on from there.")


class UploadTooLarge(TooLarge):
    """The upload is larger than the server takes."""

    def __init__(self, max_bytes: int) -> None:
        """Name the cap."""
        super().__init__(f"The upload is larger than {max_bytes} bytes; compress it better or drop boxes of low score.")
        self.max_bytes = max_bytes


class UnsupportedMediaType(ServerError):
    """The body is of a kind the address does not take."""

    code = "unsupported_media_type"
    status = 415


class InvalidValue(msgspec.Struct, frozen=True):
    """One value of a request that cannot be used."""

    pointer: str
    """Where it is: `query/phase`, `body/publication`, `header/if-none-match`."""
    detail: str


class ValidationFailed(ServerError):
    """Values of the request are missing or cannot be used."""

    code = "invalid_request"
    status = 422

    def __init__(self, errors: tuple[InvalidValue, ...]) -> None:
        """Keep every value that is wrong."""
        super().__init__("Correct: " + "; ".join(f"{error.pointer} ({error.detail})" for error in errors) + ".")
        self.errors = errors


class ArchiveRefused(ServerError):
    """The archive is not one the benchmark opens; the report says everything that is wrong. It cost no quota."""

    code = "archive_refused"
    status = 422

    def __init__(self, report: Report) -> None:
        """Carry the report and say its first line."""
        first = next((group for group in report.groups if group.severity == "error"), None)
        super().__init__(f"{first.title} {first.fix}" if first else "The archive cannot be read.")
        self.report = report


class DigestMismatch(ServerError):
    """What arrived is not what the digest header announces."""

    code = "digest_mismatch"
    status = 422

    def __init__(self) -> None:
        """Say what helps."""
        super().__init__("The body's SHA-256 differs from the digest header: it was changed on the way; send it again.")


class TooManyRequests(ServerError):
    """Too many attempts from this address in a short time."""

    code = "too_many_requests"
    status = 429

    def __init__(self, retry_after_s: int) -> None:
        """Keep when asking again may help."""
        super().__init__(f"Too many failed attempts from your address; try again in {retry_after_s} s.")
        self.retry_after_s = retry_after_s


class TooManyUploads(Unavailable):
    """As many uploads as the server takes are under way."""

    code = "too_many_uploads"
    retry_after_s = 5

    def __init__(self, message: str = "") -> None:
        """Say what helps."""
        super().__init__(
            message or f"The server is taking as many uploads as it can; try again in {self.retry_after_s} s."
        )


class TooManyOwnUploads(TooManyUploads):
    """As many uploads of one user as the server takes at a time are under way."""

    code = "too_many_own_uploads"

    def __init__(self, most: int) -> None:
        """Say what helps."""
        super().__init__(f"{most} uploads of yours are under way, the most at a time; wait for one of them to end.")


class DiskFull(StorageFull):
    """There is no room to keep the upload."""

    def __init__(self) -> None:
        """Say what helps."""
        super().__init__("The server has no room for this upload; the maintainers have to make some. Try again later.")
