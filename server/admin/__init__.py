"""`cs3d-admin`: what maintainers do, from an empty machine to a running benchmark.

entry.py         where the command starts, also when the server's packages are missing
main.py          the command line: settings, errors, output
command.py       what a command is and what it gives back
listing.py       what the commands that list rows give back
installation.py  init, migrate, serve, worker
people.py        users, teams and tokens
benchmarks.py    create-benchmark, import-ground-truth, grant
phases.py        create-phase, edit-phase, list-phases, set-shards
submissions.py   list-submissions, requeue, publish, hold, release, status
rescoring.py     rescore start, status, diff, retry, exclude, publish, discard
trail.py         audit
checking.py      check
backups.py       backup, restore
demo*.py         demo: a whole benchmark with three imaginary methods
"""
