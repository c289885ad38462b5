"""Lists of what is in the record: whole values for programs, one line for each row for people."""

import argparse
import json
import textwrap
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from server.admin.command import Outcome, lines, whole_number

MOST_ROWS = 10_000
"""Their ids fit into one query."""

LONGEST_DETAIL = 300
"""Characters of an event's detail in a table; --json has all of it."""


def add_limit(parser: argparse.ArgumentParser) -> None:
    """Add the option that says how many rows are listed."""
    rows = whole_number(1, MOST_ROWS)
    parser.add_argument("--limit", type=rows, default=50, metavar="N", help="so many at most (default: %(default)s)")


def listing(name: str, rows: Sequence[Mapping[str, Any]], *, limit: int | None = None) -> Outcome:
    """List rows.

    Args:
        name: What they are; the key of the list in the JSON.
        rows: Their values by name, the same names in each; with a limit one more row than that says that there are more.
        limit: So many are shown at most; None: all.
    """
    shown = rows[:limit]
    data: dict[str, Any] = {name: [{key: _written(value) for key, value in row.items()} for row in shown]}
    if limit is not None:
        data["more"] = len(rows) > limit
    if not shown:
        return Outcome(data=data, text=f"No {name}.")
    headings = [_HEADINGS.get(column, column.replace("_", " ")) for column in shown[0]]
    return Outcome(
        data=data,
        tables=[lines(*headings, rows=[[_cell(value) for value in row.values()] for row in shown])],
        text="There are more; --limit N lists the newest N." if data.get("more") else "",
    )


_HEADINGS = {
    "created_at": "created",
    "disabled_at": "disabled",
    "mds": "mDS",
    "opens_at": "opens",
    "closes_at": "closes",
}


def _written(value: object) -> object:
    """Write a value down as JSON."""
    return value.astimezone(UTC).isoformat() if isinstance(value, datetime) else value


def _cell(value: object) -> object:
    """Write a value down for people: times in UTC, what is not there as a hyphen."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return value
    if isinstance(value, datetime):
        return f"{value.astimezone(UTC):%Y-%m-%d %H:%M:%S}"
    if not value:
        return "-"
    if isinstance(value, dict):
        return textwrap.shorten(json.dumps(value), LONGEST_DETAIL, placeholder=" ...")
    return ", ".join(value) if isinstance(value, list) else value
