"""The root of the project's one tree of errors.

    BenchmarkError              internal_error           everything the project raises on purpose
    ├── UsageError              usage                    a call or command that cannot be carried out as written
    ├── DataError               invalid_data             bytes that are not what they should be
    │   ├── GroundTruthError    invalid_ground_truth     evaluator/ground_truth.py
    │   ├── ArrayFileError      invalid_array_file       evaluator/array_file.py
    │   └── BackupError         invalid_backup           server/backup.py
    ├── ServerRefused           server_refused           client/server_api.py
    ├── ServerUnreachable       server_unreachable       client/server_api.py
    └── ServerError             internal_error           what the server answers: server/errors.py, docs/api.md

What is wrong in a submission is no exception: it becomes an entry of its report, with a code of evaluator/codes.py.
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
