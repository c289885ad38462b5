"""Lists of submissions: in order over all teams, a page at a time, by as many queries for many rows as for few."""

import uuid
from collections.abc import Iterator
from contextlib import contextmanager

import httpx
import pytest
import sqlalchemy as sa

from server import accounts, submissions
from server.pages import paging
from server.services import Services
from tests.integration.pages.test_pages import ann
from tests.integration.site import Site, send
from worker.evaluation import evaluate_submission
from worker.sandbox import Sandbox

pytestmark = pytest.mark.parametrize("shape", ["embedded"], indirect=True)
"""How many queries there are, and in which order rows come, does not depend on the database."""

LISTS = (
    "/api/v1/submissions",
    "/api/v1/leaderboards/cs3d/test",
    "/",
    "/submissions",
    "/methods/lab/m0",
    "/benchmarks/cs3d/test",
    "/benchmarks/cs3d/test/compare",
)


@contextmanager
def queries(services: Services) -> Iterator[list[str]]:
    """Collect the statements that are executed within the block."""
    found: list[str] = []

    def hear(*arguments: object) -> None:
        found.append(str(arguments[2]))

    sa.event.listen(services.engine, "before_cursor_execute", hear)
    try:
        yield found
    finally:
        sa.event.remove(services.engine, "before_cursor_execute", hear)


def add_scored(site: Site, sandbox: Sandbox, archive: bytes, method: str, *, publish: bool) -> None:
    """Send and score predictions; if wanted, publish them."""
    with site.client(site.token()) as client:
        submission_id = uuid.UUID(send(client, archive, method=method).json()["id"])
    evaluate_submission(site.services, sandbox, submission_id, worker="test")
    if publish:
        with site.services.transaction() as session:
            submissions.publish(session, submissions.find(session, submission_id), "user:1")


def costs(site: Site, client: httpx.Client) -> dict[str, int]:
    """Count the queries of each list once everything that is kept in memory is there."""
    found = {}
    for address in LISTS:
        client.get(address).raise_for_status()
        with queries(site.services) as statements:
            client.get(address).raise_for_status()
        found[address] = len(statements)
    return found


def test_many_rows_take_as_many_queries_as_few(site: Site, sandbox: Sandbox, archive: bytes) -> None:
    """Each list asks the same number of queries for 2 rows and for 20, of several methods and of one."""

    def add(method: int) -> None:
        add_scored(site, sandbox, archive, f"m{method}", publish=True)
        add_scored(site, sandbox, archive, "m0", publish=False)

    with ann(site) as client:
        for method in range(1, 3):
            add(method)
        few = costs(site, client)
        for method in range(3, 21):
            add(method)
        many = costs(site, client)
    assert many == few


def test_lists_do_not_read_what_they_do_not_show(site: Site, sandbox: Sandbox, archive: bytes) -> None:
    """For one number a row neither summaries nor audits of scores are read, which are large."""
    add_scored(site, sandbox, archive, "m0", publish=True)
    with ann(site) as client:
        for address in ("/api/v1/submissions", "/submissions", "/"):
            with queries(site.services) as statements:
                client.get(address).raise_for_status()
            assert not [one for one in statements if "score.summary" in one or "score.integrity" in one]


def test_submissions_of_all_teams_are_in_one_order(site: Site, archive: bytes) -> None:
    """Whoever is in two teams sees the latest of both first; `limit` and `offset` count over both."""
    other = site.stranger()
    with site.services.transaction() as session:
        user = accounts.find_user(session, "ann@example.org")
        accounts.add_member(session, accounts.find_team(session, "others"), user, actor="admin:test")
    tokens = [site.token(), other, site.token()]
    sent = []
    for token in tokens:
        with site.client(token) as client:
            sent.append(send(client, archive).json()["id"])

    with ann(site) as client:
        pages = [client.get("/api/v1/submissions", params={"limit": 2, "offset": offset}).json() for offset in (0, 2)]

    assert [[row["id"] for row in page["submissions"]] for page in pages] == [[sent[2], sent[1]], [sent[0]]]


def test_a_method_is_shown_a_page_at_a_time(site: Site, archive: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """With two to a page the oldest of three is on the second, the last; those who may see none see no page."""
    monkeypatch.setattr(paging, "PER_PAGE", 2)
    with site.client(site.token()) as client:
        latest_first = [send(client, archive).json()["id"] for _ in range(3)][::-1]
    with ann(site) as client:
        first, second = (client.get("/methods/lab/ours", params={"page": page}).text for page in (1, 2))
        assert client.get("/methods/lab/ours", params={"page": 3}).status_code == 404
    with site.client() as nobody:
        assert nobody.get("/methods/lab/ours").status_code == 404
    assert [one in first for one in latest_first] == [True, True, False]
    assert [one in second for one in latest_first] == [False, False, True]
    assert ("Older" in first, "Newer" in first) == (True, False)
    assert ("Older" in second, "Newer" in second) == (False, True)
