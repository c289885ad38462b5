"""Tables of text for the terminal; numbers are rounded here and nowhere else, and what rounds to 0 has no minus."""

from collections.abc import Sequence

UNDEFINED = "n/a"


def text_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a titled table: the first column to the left, the others to the right, a rule below the header."""
    head, *lines = aligned([header, *rows])
    return "\n".join([title, head.rstrip(), "-" * len(head), *(line.rstrip() for line in lines)])


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines of equal length: the first column to the left, the others to the right."""
    first, *rest = (max(map(len, column)) for column in zip(*rows, strict=True))
    return [
        "  ".join([row[0].ljust(first), *(cell.rjust(width) for cell, width in zip(row[1:], rest, strict=True))])
        for row in rows
    ]


def number(value: float | None, digits: int = 2) -> str:
    """Write a number with fixed digits, "n/a" for None."""
    return UNDEFINED if value is None else f"{value:z.{digits}f}"


def percent(value: float | None, digits: int = 2) -> str:
    """Write a share in percent, "n/a" for None."""
    return UNDEFINED if value is None else f"{100 * value:z.{digits}f}"


def points(value: float | None) -> str:
    """Write a difference in percent points with its sign, "n/a" for None."""
    return UNDEFINED if value is None else f"{100 * value:+z.2f}"
