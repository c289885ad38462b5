"""A scoring process on a kernel that refuses sockets to nobody, and the Celery application of a worker that starts it."""

from worker import child, confinement, sandbox

if __name__ == "__main__":
    child._leave_network = confinement.refuse_sockets = lambda: False
    child.main()
else:
    sandbox.PROGRAM = __name__
    from worker.app import app  # noqa: F401 - Celery's entry
