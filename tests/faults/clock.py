"""A clock that is wrong. Shifted before anything else is imported: whoever takes `time.time` takes this one."""

import os
import time
from datetime import datetime, tzinfo
from types import ModuleType

VARIABLE = "CS3D_TEST_CLOCK_SHIFT_S"
"""By how much `time.time` is wrong in this process, in seconds.

The database's clock and the kernel's, which file times come from, are right, and so is what libraries read from `datetime`.
"""


def shift() -> None:
    """Make the clock of this process as wrong as the environment says."""
    if shift_s := float(os.environ.get(VARIABLE, "0")):
        right = time.time
        time.time = lambda: right() + shift_s


class _Shifted(datetime):
    """The time that this process believes in."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> "_Shifted":
        """Follow `time.time`."""
        return cls.fromtimestamp(time.time(), tz)


def shift_datetime_of(module: ModuleType) -> None:
    """Let the functions of a module read the wrong clock too."""
    setattr(module, "datetime", _Shifted)  # noqa: B010 - the checker of types minds a plain assignment
