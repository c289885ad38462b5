"""Run a command that ends when the process that started it ends, even by `kill -9`.

    python tether.py PARENT_PID COMMAND [ARGUMENT...]

It becomes the command, so the command has its process id. Run as a script, not imported: between fork and exec of a
process with threads no Python may run. Standard library only, for a quick start. Linux; elsewhere it does nothing.
"""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1


def main() -> None:
    """Ask the kernel for the signal, then become the command."""
    parent, command = int(sys.argv[1]), sys.argv[2:]
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:  # it ended before the kernel was asked
            sys.exit(1)
    os.execvp(command[0], command)  # noqa: S606 (no shell is wanted)


if __name__ == "__main__":
    main()
