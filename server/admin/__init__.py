"""`cs3d-admin`: what maintainers do, from an empty machine to a running benchmark.

entry.py         where the command starts, also when the server's packages are missing
main.py          the command line: settings, errors, output
command.py       what a command is and what it gives back
installation.py  init, migrate, serve, worker
people.py        users, teams and tokens
benchmarks.py    create-benchmark, create-phase, import-ground-truth, grant
submissions.py   requeue, publish, hold, release, status
rescoring.py     rescore start, status, diff, retry, exclude, publish, discard
checking.py      check
backups.py       backup, restore
demo*.py         demo: a whole benchmark with three imaginary methods
"""
