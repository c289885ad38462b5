"""The report on a submission's bytes: every problem named, located and with its fix."""

from typing import Literal

import msgspec

Severity = Literal["error", "warning", "note"]
"""error: the submission is rejected. warning: it is scored, but probably not as meant. note: worth knowing."""

MAX_LOCATED_PROBLEMS = 1000
"""Problems listed one by one in a report, over all groups; the counts are always complete."""


class Problem(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One place where something is wrong."""

    file: str | None = None
    """The archive member or path, as the uploader named it."""
    pointer: str | None = None
    """RFC 6901 JSON pointer into that file; an empty string is the whole document."""
    found: str | None = None
    expected: str | None = None
    detail: str | None = None


class ProblemGroup(msgspec.Struct, frozen=True, kw_only=True):
    """All problems of one cause."""

    code: str
    """Stable; listed in docs/errors.md."""
    severity: Severity
    title: str
    """One sentence: what is wrong."""
    fix: str
    """One sentence: what to change."""
    count: int
    """How many there are in all."""
    problems: tuple[Problem, ...]
    """The first of them, located."""
    confidence: float | None = None
    """For recognised mistakes (the convention doctor), in [0, 1]."""


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """What was found in a submission. It never holds anything about the ground truth but the image names."""

    groups: tuple[ProblemGroup, ...]
    """Errors first, then warnings, then notes."""
    images_expected: int
    images_found: int
    boxes: int
    """Boxes of evaluated classes that were read."""

    @property
    def error_count(self) -> int:
        """Count the problems that reject the submission."""
        return sum(group.count for group in self.groups if group.severity == "error")

    @property
    def accepted(self) -> bool:
        """True when nothing rejects the submission."""
        return self.error_count == 0
