"""Lists of submissions, a page at a time."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import submissions
from server.models import Submission

PER_PAGE = 50


@dataclass(frozen=True, slots=True)
class Page:
    """Some submissions, latest first."""

    number: int
    """From 1, the latest."""
    rows: list[Submission]
    more: bool
    """True when older ones follow."""


def page_of(session: Session, query: Mapping[str, str], *conditions: sa.ColumnElement[bool]) -> Page:
    """Read the page that an address asks for of the submissions that meet all conditions.

    Whatever is no number shows the first page; beyond the last one there are no rows.
    """
    asked = query.get("page", "1")
    number = max(1, int(asked)) if re.fullmatch(r"[0-9]{1,9}", asked) else 1
    rows = submissions.latest(session, *conditions, limit=PER_PAGE + 1, offset=(number - 1) * PER_PAGE)
    return Page(number, rows[:PER_PAGE], len(rows) > PER_PAGE)
