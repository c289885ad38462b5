"""The entry point of `cs3d-admin`, which is installed with the evaluator alone, too: then it says what is missing."""

import sys

EXTRA_MISSING = 1


def run() -> int:
    """Run the command line where the server's packages are installed; return the exit status."""
    try:
        from server.admin.main import main  # noqa: PLC0415 - what may fail here is the point
    except ModuleNotFoundError as error:
        message = f'the server needs packages that are not installed ({error.name}): pip install ".[server]"'
        print(f"cs3d-admin: {message}", file=sys.stderr)
        return EXTRA_MISSING
    return main()
