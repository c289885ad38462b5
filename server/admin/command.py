"""What a command of `cs3d-admin` is, and what it gives back."""

import argparse
import getpass
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.cells import cell_len
from rich.table import Table
from rich.text import Text

from server.services import Services

DONE, REFUSED, WRONG_USAGE = 0, 1, 2
"""Exit statuses."""

MOST = 2**31 - 1
"""The largest number of a column; ids are no larger."""

LAST_PORT = 65535


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a command did: values for programs, a sentence or tables for people."""

    data: dict[str, Any]
    """Printed as JSON with --json."""
    text: str = ""
    tables: Sequence[Table] = field(default=())
    status: int = DONE


Run = Callable[[argparse.Namespace, Services], Outcome]
Subparsers = Any
"""argparse names the type of its sub parsers only privately."""


def add(subparsers: Subparsers, name: str, run: Run, *, needs_tables: bool = True) -> argparse.ArgumentParser:
    """Add a command that `run` carries out; its docstring's first line is the help.

    Args:
        subparsers: Of the root parser.
        name: What the user types.
        run: What carries it out.
        needs_tables: False for the commands that make the tables or do without.
    """
    summary = (run.__doc__ or "").split("\n", maxsplit=1)[0]
    parser: argparse.ArgumentParser = subparsers.add_parser(name, help=summary, description=summary)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument(
        "--data-dir", metavar="FOLDER", help="the installation's folder (default: CS3D_DATA_DIR or ./data)"
    )
    parser.set_defaults(run=run, needs_tables=needs_tables)
    return parser


def add_phase(parser: argparse.ArgumentParser) -> None:
    """Add the two arguments that name a phase."""
    parser.add_argument("benchmark")
    parser.add_argument("phase")


def whole_number(least: int, most: int = MOST) -> Callable[[str], int]:
    """Make what reads a whole number of an option; another one is wrong usage."""

    def read(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = least - 1
        if not least <= number <= most:
            message = f"{text!r} is not a whole number from {least} to {most}"
            raise argparse.ArgumentTypeError(message)
        return number

    return read


port_number = whole_number(1, LAST_PORT)
"""Reads a TCP port."""


def counted(number: int, thing: str, things: str | None = None) -> str:
    """Write how many there are: `1 member`, `2 members`; `things` where it is not `thing` with an s."""
    return f"{number} {thing if number == 1 else things or thing + 's'}"


def actor() -> str:
    """Name who runs the command, for the audit trail."""
    return f"admin:{getpass.getuser()}"


def table(*columns: str, rows: Sequence[Sequence[object]]) -> Table:
    """Make a plain table; None is shown as n/a, numbers stand right."""
    result = Table(box=None, header_style="bold", padding=(0, 1, 0, 0), pad_edge=False)
    for position, column in enumerate(columns):
        numeric = any(isinstance(row[position], int | float) for row in rows)
        result.add_column(column, justify="right" if numeric else "left", no_wrap=numeric, overflow="fold")
    for row in rows:
        result.add_row(*(Text(_cell(value)) for value in row))  # text: a name may look like markup
    return result


def lines(*columns: str, rows: Sequence[Sequence[object]]) -> Table:
    """Make a table with one line for each row, however long: values stay whole for copying and for grep."""
    result = table(*columns, rows=rows)
    # As wide as its values, not as the terminal: rich leaves out what does not fit.
    widths = [max(cell_len(str(cell)) for cell in (column.header, *column.cells)) for column in result.columns]
    result.width = sum(widths) + len(widths) - 1
    return result


def _cell(value: object) -> str:
    """Write down one value; scores in per cent with one decimal, as the field prints them."""
    if value is None:
        return "n/a"
    return f"{100 * value:.1f}" if isinstance(value, float) else str(value)
