"""A worker's main process forks only while its sweeper is still."""

import subprocess
import sys

from tests.services.worker import ROOT

PROGRAM = """
import os, threading, time
from worker.sweeping import _ForkGuard

guard, at_work, began = _ForkGuard(), False, threading.Event()

def sweep():
    global at_work
    with guard.lock:
        at_work = True
        began.set()
        time.sleep(0.5)
        at_work = False

threading.Thread(target=sweep).start()
began.wait()
child = os.fork()
if child == 0:
    os._exit(3 if at_work or guard.lock.locked() else 0)
status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
raise SystemExit(status or (4 if guard.lock.locked() else 0))
"""


def test_a_fork_waits_for_the_pass_to_end() -> None:
    """A process that is forked during a pass finds it ended, and its lock free, as does the one that forked it."""
    run = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
