"""Freed memory stays with the process."""

import platform
import resource
import subprocess
import sys

import pytest

PROGRAM = """
import resource
import numpy as np
from evaluator.memory import keep_freed_memory
{call}
faults = []
for _ in range(4):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(131_072) for _ in range(64)]
    faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
    del arrays
print(*faults)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other allocators are left alone")
@pytest.mark.parametrize(("call", "is_kept"), [("keep_freed_memory()", True), ("", False)])
def test_memory_that_was_freed_is_not_asked_for_again(call: str, *, is_kept: bool) -> None:
    """64 arrays of 1 MB are written to again and again: pages are handed out the first time only."""
    done = subprocess.run([sys.executable, "-c", PROGRAM.format(call=call)], capture_output=True, text=True, check=True)

    first, *others = map(int, done.stdout.split())
    assert first > 64 * 2**20 // resource.getpagesize() // 2
    assert (max(others) < first / 10) == is_kept
