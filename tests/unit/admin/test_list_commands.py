"""Commands that list what the record holds, and what waits for a maintainer."""

import json
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import sqlalchemy as sa

from server import submissions
from server.admin.main import main
from server.models import AuditEvent
from server.services import Services
from tests.unit.admin.filled import Admin, Refused, Says, fail_one, populate, score_one, send_one
from worker.sandbox import Sandbox


@pytest.fixture
def busy(admin: Admin, services: Services, sandbox: Sandbox) -> dict[str, str]:
    """Ids of submissions by what became of them, oldest first: waits, failed, other (team, phase), held."""
    populate(admin)
    admin("create-team", "rivals", "--name", "Rivals", "--member", "ann@example.org")
    admin("create-phase", "cs3d", "val", "--title", "Val", "--open")
    with services.transaction() as session:
        session.execute(sa.text("UPDATE phase SET ground_truth_id = 1"))
    ids = {"waits": send_one(services), "failed": fail_one(services)}
    ids["other"] = send_one(services, team="rivals", phase="val", method="theirs")
    ids["held"] = score_one(services, sandbox)
    admin("hold", str(ids["held"]), "--reason", "a copy? [/b]")
    return {name: str(key) for name, key in ids.items()}


@contextmanager
def _counted_queries() -> Iterator[list[str]]:
    """Collect what every engine is asked."""
    asked: list[str] = []

    def note(*arguments: object) -> None:
        asked.append(str(arguments[2]))

    sa.event.listen(sa.Engine, "before_cursor_execute", note)
    try:
        yield asked
    finally:
        sa.event.remove(sa.Engine, "before_cursor_execute", note)


def test_submissions_are_found_by_what_is_said_of_them(admin: Admin, busy: dict[str, str]) -> None:
    """Every condition holds at once; the newest stands first."""
    names = {key: name for name, key in busy.items()}
    expected = {
        "": ["held", "other", "failed", "waits"],
        "--held": ["held"],
        "--state failed": ["failed"],
        "--team rivals": ["other"],
        "--phase test": ["held", "failed", "waits"],
        "--benchmark cs3d --phase val": ["other"],
        "--benchmark cs3d --team lab --state received": ["waits"],
        "--held --state failed": [],
    }
    listed = {options: admin("list-submissions", *options.split()) for options in expected}
    assert {
        options: [names[one["id"]] for one in found["submissions"]] for options, found in listed.items()
    } == expected
    assert not any(found["more"] for found in listed.values())


def test_a_listed_submission_says_what_a_maintainer_needs(admin: Admin, busy: dict[str, str]) -> None:
    """Whose it is, where it stands, its score, and why it is held or failed."""
    listed = {one.pop("id"): one for one in admin("list-submissions")["submissions"]}
    held, failed = listed[busy["held"]], listed[busy["failed"]]
    assert held.pop("created_at").endswith("+00:00")
    assert 0 < held.pop("mds") <= 1
    assert held == {
        "team": "lab",
        "method": "ours",
        "benchmark": "cs3d",
        "phase": "test",
        "state": "scored",
        "publication": "private",
        "failure": None,
        "held": "a copy? [/b]",
    }
    assert (failed["failure"], failed["mds"], failed["held"]) == ("out_of_memory", None, None)


def test_a_row_is_one_line_with_its_whole_id(says: Says, busy: dict[str, str]) -> None:
    """Nothing is folded or left out on a narrow screen, and what looks like markup is shown as it is."""
    heading, line = says("list-submissions", "--held").splitlines()
    assert heading.split() == [
        "id",
        "created",
        "team",
        "method",
        "benchmark",
        "phase",
        "state",
        "mDS",
        "publication",
        "failure",
        "held",
    ]
    assert line.startswith(busy["held"])
    assert line.rstrip().endswith("a copy? [/b]")


def test_a_limit_says_that_there_are_more(admin: Admin, says: Says, busy: dict[str, str]) -> None:
    """Two of four are the newest two."""
    listed = admin("list-submissions", "--limit", "2")
    assert ([one["id"] for one in listed["submissions"]], listed["more"]) == ([busy["held"], busy["other"]], True)
    assert says("list-submissions", "--limit", "2").endswith("There are more; --limit N lists the newest N.\n")
    assert admin("list-submissions", "--limit", "4")["more"] is False


@pytest.mark.parametrize(
    ("options", "status", "said"),
    [
        (["--benchmark", "kitti"], 1, "no benchmark 'kitti'"),
        (["--phase", "final"], 1, "cs3d-admin list-phases"),
        (["--team", "nobody"], 1, "no team 'nobody'"),
        (["--state", "done"], 2, "invalid choice"),
        (["--limit", "0"], 2, "from 1 to 10000"),
    ],
)
def test_what_is_not_there_is_not_an_empty_list(refused: Refused, options: list[str], status: int, said: str) -> None:
    """A misspelt name is refused instead of finding nothing."""
    ended, message = refused("list-submissions", *options)
    assert (ended, said in message) == (status, True), message


def test_status_counts_what_waits_for_a_maintainer(
    busy: dict[str, str], data_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Held and failed ones are counted, and the commands that list them are named; no broker: status 1."""
    assert busy
    assert main(["status", "--data-dir", str(data_dir), "--json"]) == 1
    status = json.loads(capsys.readouterr().out)
    assert status["broker_depth"] is None
    counted = [
        (one["phase"], one["version"], one["held"], {state: n for state, n in one["states"].items() if n})
        for one in status["phases"]
    ]
    assert counted == [("test", 1, 1, {"received": 1, "failed": 1, "scored": 1}), ("val", 1, 0, {"received": 1})]
    assert main(["status", "--data-dir", str(data_dir)]) == 1
    table, _, said = capsys.readouterr().out.partition("\n1 submission held")
    assert table.split("\n")[0].split() == ["phase", "ground", "truth", "received", "scored", "failed", "held"]
    assert said == (
        " for a maintainer: cs3d-admin list-submissions --held\n"
        "1 submission failed: cs3d-admin list-submissions --state failed\n"
        "The broker does not answer.\n"
    )


def test_users_teams_and_phases_are_listed(admin: Admin, busy: dict[str, str]) -> None:
    """By name, with what belongs to them; a disabled user says since when."""
    assert busy
    admin("create-user", "bob@example.org", "--name", "Bob", "--maintainer")
    admin("disable-user", "bob@example.org")
    ann, bob = admin("list-users")["users"]
    assert (ann["email"], ann["teams"], ann["maintainer"], ann["disabled_at"]) == (
        ("ann@example.org", ["lab", "rivals"], False, None)
    )
    assert (bob["teams"], bob["maintainer"], bob["disabled_at"] is not None) == ([], True, True)
    assert [(one["team"], one["name"], one["members"]) for one in admin("list-teams")["teams"]] == [
        ("lab", "The Lab", ["ann@example.org"]),
        ("rivals", "Rivals", ["ann@example.org"]),
    ]
    test, val = admin("list-phases", "--benchmark", "cs3d")["phases"]
    assert (test["phase"], test["ground_truth_version"], test["is_open"], test["closes_at"]) == ("test", 1, False, None)
    assert (val["phase"], val["protocol"], val["is_open"], val["shards"]) == ("val", "cityscapes3d", True, 1)


def test_an_empty_installation_has_empty_lists(admin: Admin, says: Says, refused: Refused) -> None:
    """Nothing there is said in words, or is an empty list; a benchmark that is not there is refused."""
    assert says("list-users") == "No users.\n"
    assert admin("list-teams") == {"teams": []}
    assert says("list-phases") == "No phases.\n"
    assert admin("list-submissions") == {"submissions": [], "more": False}
    assert says("audit") == "No events.\n"
    assert refused("list-phases", "--benchmark", "kitti")[0] == 1


def test_more_rows_take_no_more_queries(admin: Admin, services: Services, busy: dict[str, str]) -> None:
    """Twice the users, teams, tokens, phases and submissions are read by as many queries."""
    assert busy
    admin("create-token", "ann@example.org", "lab")
    commands = ("list-submissions", "list-users", "list-teams", "list-phases", "audit", "list-tokens ann@example.org")

    def run(command: str) -> tuple[int, int]:
        with _counted_queries() as asked:
            listed = admin(*command.split())
        (rows,) = (value for name, value in listed.items() if name != "more")
        return len(rows), len(asked)

    few = {command: run(command) for command in commands}
    for number in range(4):
        admin("create-user", f"{number}@example.org", "--name", "N")
        members = ["--member", "ann@example.org", "--member", f"{number}@example.org"]
        admin("create-team", f"team{number}", "--name", "N", *members)
        admin("create-token", "ann@example.org", f"team{number}", "--days", "3")
        admin("create-phase", "cs3d", f"phase{number}", "--title", "N")
        send_one(services, team=f"team{number}", method=f"m{number}")
    many = {command: run(command) for command in commands}
    for command in commands:
        (rows_before, asked_before), (rows, asked) = few[command], many[command]
        assert rows >= rows_before + 4
        assert (command, asked) == (command, asked_before)
        assert asked > 0


def test_the_trail_is_printed_newest_first(admin: Admin, busy: dict[str, str]) -> None:
    """Who did what to whom; with everything that the event keeps."""
    subject = f"submission:{busy['held']}"
    events = admin("audit", "--subject", subject)["events"]
    assert [event["action"] for event in events] == [
        "submission.held",
        "submission.scored",
        "submission.scoring",
        "submission.queued",
        "submission.received",
    ]
    assert {event["subject"] for event in events} == {subject}
    assert events[0]["actor"].startswith("admin:")
    assert events[0]["detail"]["reason"] == "a copy? [/b]"
    ids = [event["id"] for event in admin("audit", "--limit", "10000")["events"]]
    assert ids == sorted(ids, reverse=True)


def test_the_trail_is_searched_by_action(admin: Admin, services: Services, busy: dict[str, str]) -> None:
    """One action, a whole kind of them, or nothing: `_` stands for itself alone."""
    (failed,) = admin("audit", "--action", "submission.failed")["events"]
    assert failed["subject"] == f"submission:{busy['failed']}"
    teams = admin("audit", "--action", "team")["events"]
    assert [event["action"] for event in teams] == ["team.joined", "team.created"] * 2
    newest = admin("audit", "--action", "team", "--limit", "1")
    assert (newest["events"], newest["more"]) == (teams[:1], True)
    assert admin("audit", "--action", "tea_")["events"] == []
    with services.snapshot() as session:
        total = session.scalar(sa.select(sa.func.count()).select_from(AuditEvent))
        assert submissions.find(session, uuid.UUID(busy["waits"])).held_reason is None
    assert total == len(admin("audit", "--limit", "10000")["events"])


@pytest.mark.parametrize("subject", ["lab", "user:1", "41a3", ":"])
def test_a_subject_that_the_trail_never_names_is_wrong_usage(refused: Refused, subject: str) -> None:
    """The message lists the kinds there are."""
    status, said = refused("audit", "--subject", subject)
    assert (status, "user_account:ID" in said) == (2, True)
