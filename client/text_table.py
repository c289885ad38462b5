"""Tables of text for the terminal; numbers are rounded here and nowhere else."""

from collections.abc import Sequence

UNDEFINED = "n/a"


def text_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a titled table: the first column to the left, the others to the right."""
    lines = [header, *rows]
    first, *rest = (max(len(cell) for cell in column) for column in zip(*lines, strict=True))
    text = [
        "  ".join([line[0].ljust(first), *(cell.rjust(width) for cell, width in zip(line[1:], rest, strict=True))])
        for line in lines
    ]
    return "\n".join([title, text[0].rstrip(), "-" * len(text[0]), *(line.rstrip() for line in text[1:])])


def number(value: float | None, digits: int = 2) -> str:
    """Write a number with fixed digits, "n/a" for None."""
    return UNDEFINED if value is None else f"{value:.{digits}f}"


def percent(value: float | None) -> str:
    """Write a share in percent, "n/a" for None."""
    return UNDEFINED if value is None else f"{100 * value:.2f}"


def points(value: float | None) -> str:
    """Write a difference in percent points with its sign, "n/a" for None."""
    return UNDEFINED if value is None else f"{100 * value:+.2f}"
