"""The root of the project's one tree of errors.

    BenchmarkError                 everything the project raises on purpose
    ├── UsageError                 a call or command that cannot be carried out as written
    ├── DataError                  bytes that are not what they should be
    │   ├── ArchiveError           a zip that breaks the framing rules      (evaluator/archive.py)
    │   ├── GroundTruthError       ground truth that cannot be used         (evaluator/ground_truth.py)
    │   └── PredictionError        predictions with errors; carries the Report
    └── ServerError                what the server answers with a problem document (server/errors.py)

Every class has a stable `code`, part of the public interface, and the HTTP status it is answered with.
The message names the fix.
"""

from typing import ClassVar


class BenchmarkError(Exception):
    """Something the project reports on purpose; `str(error)` says what to do about it."""

    code: ClassVar[str] = "internal_error"
    status: ClassVar[int] = 500


class UsageError(BenchmarkError):
    """The call cannot be carried out as written."""

    code = "usage"
    status = 400


class DataError(BenchmarkError):
    """The bytes given are not what they should be."""

    code = "invalid_data"
    status = 422
