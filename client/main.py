"""The command `cs3d`: evaluate, explain and validate offline, submit and watch online.

Exit status: 0 done, 1 the data has problems (a report is on stderr), 2 wrong usage.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module

from evaluator.errors import BenchmarkError

COMMANDS = {
    "evaluate": "client.evaluate",
    "diagnose": "client.diagnose",
    "compare": "client.compare",
    "validate": "client.validate",
    "submit": "client.submit",
    "watch": "client.watch",
}
"""Sub command -> module with `add_parser(subparsers)` and `run(args) -> int`."""

PROBLEMS_IN_DATA = 1
WRONG_USAGE = 2


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Build the parser with one sub command, or with all when `command` is none of them.

    Loading only what is asked for keeps the start fast: evaluating needs no HTTP client.
    """
    parser = argparse.ArgumentParser(prog="cs3d", description="Cityscapes 3D benchmark: evaluate, validate, submit.")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name in [command] if command in COMMANDS else COMMANDS:
        import_module(COMMANDS[name]).add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    parser = build_parser(arguments[0] if arguments else None)
    args = parser.parse_args(arguments)
    try:
        status = int(import_module(COMMANDS[args.command]).run(args))
        sys.stdout.flush()
    except BenchmarkError as error:
        print(f"cs3d: {error}", file=sys.stderr)
        return WRONG_USAGE if error.code == "usage" else PROBLEMS_IN_DATA
    except BrokenPipeError:  # the reader of a pipe (head, less) closed it; nothing is wrong
        _drop_output()
        return 0
    except OSError as error:
        _drop_output()
        print(f"cs3d: {error}; check the paths, their permissions and the room on the disk.", file=sys.stderr)
        return WRONG_USAGE
    return status


def _drop_output() -> None:
    """Let what is still buffered go nowhere: at exit Python would try once more to write it, and fail."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
