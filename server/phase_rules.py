"""The rules of a phase: what a maintainer chooses at its creation and may choose anew while it runs.

Its protocol and ground truth are no rules: they change by scoring again (server/rescoring.py).
"""

from datetime import UTC, datetime
from typing import TypedDict

from server.accounts import checked_text
from server.errors import InvalidField
from server.models import Phase

MOST_IN_A_RULE = 1_000_000
"""More submissions, rejections or attempts than any phase counts."""


class PhaseRules(TypedDict, total=False):
    """What a maintainer decides about a phase and may change with `benchmarks.edit_phase`."""

    title: str
    is_open: bool
    allows_publication: bool
    opens_at: datetime | None
    closes_at: datetime | None
    submissions_per_day: int
    rejections_per_day: int
    max_attempts: int


def rules_of(phase: Phase) -> PhaseRules:
    """Read the rules of a phase."""
    return PhaseRules(
        title=phase.title,
        is_open=phase.is_open,
        allows_publication=phase.allows_publication,
        opens_at=phase.opens_at,
        closes_at=phase.closes_at,
        submissions_per_day=phase.submissions_per_day,
        rejections_per_day=phase.rejections_per_day,
        max_attempts=phase.max_attempts,
    )


def written_rules(rules: PhaseRules) -> dict[str, object]:
    """Write rules down as JSON values, times in UTC."""
    return {
        name: value.astimezone(UTC).isoformat() if isinstance(value, datetime) else value
        for name, value in rules.items()
    }


def checked_rules(rules: PhaseRules) -> PhaseRules:
    """Give complete rules back when a phase may have them.

    Raises:
        InvalidField: A number is out of range, the title cannot be shown, or the phase would close before it opens.
    """
    counts = (
        ("submissions_per_day", rules["submissions_per_day"], 0),
        ("rejections_per_day", rules["rejections_per_day"], 1),
        ("max_attempts", rules["max_attempts"], 1),
    )
    for name, value, least in counts:
        if not least <= value <= MOST_IN_A_RULE:
            message = f"{name} must be from {least} to {MOST_IN_A_RULE}"
            raise InvalidField(message)
    opens_at, closes_at = rules["opens_at"], rules["closes_at"]
    if opens_at is not None and closes_at is not None and closes_at <= opens_at:
        message = f"closes_at {closes_at.isoformat()} must be after opens_at {opens_at.isoformat()}; change either"
        raise InvalidField(message)
    return {**rules, "title": checked_text("title", rules["title"], max_length=200)}
