"""What pages say of phases that take no submissions now, of a spent quota, and of methods that are described again."""

import re
from collections.abc import Callable
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa

from server import benchmarks
from server.models import AuditEvent, Phase
from tests.integration.pages.test_pages import BOARD, ann, csrf_of
from tests.integration.site import Site, send

ZIP = {"Content-Type": "application/zip"}


def _set_rules(site: Site, **rules: datetime | int) -> None:
    with site.services.transaction() as session:
        phase: Phase = benchmarks.find_phase(session, "cs3d", "test")
        for name, value in rules.items():
            setattr(phase, name, value)


@pytest.mark.parametrize(
    ("rules", "said"),
    [
        ({"closes_at": datetime(2020, 1, 2, 3, 4, tzinfo=UTC)}, "Phase test closed at 2020-01-02 03:04 UTC."),
        ({"opens_at": datetime(2199, 1, 2, 3, 4, tzinfo=UTC)}, "Phase test opens at 2199-01-02 03:04 UTC."),
    ],
)
def test_a_phase_that_takes_nothing_says_so_and_offers_no_form(
    site: Site, rules: dict[str, datetime], said: str
) -> None:
    """Home, leaderboard and the page of the form say when; nobody fills in a form in vain."""
    _set_rules(site, **rules)
    with ann(site) as browser:
        for path in ("/", BOARD):
            page = browser.get(path).text
            assert said in page
            assert f"{BOARD}/submit" not in page
        form = browser.get(f"{BOARD}/submit").text
    assert said in form
    assert '<form class="card fields' not in form


def test_an_open_phase_says_until_when(site: Site) -> None:
    """The end is shown with its time, and the form is offered."""
    _set_rules(site, closes_at=datetime(2199, 1, 2, 3, 4, tzinfo=UTC))
    with ann(site) as browser:
        for path in ("/", BOARD):
            page = browser.get(path).text
            assert "2199-01-02 03:04 UTC" in page
            assert f"{BOARD}/submit" in page
        assert '<form class="card fields' in browser.get(f"{BOARD}/submit").text


def test_the_form_says_when_a_spent_quota_allows_more(site: Site, archive: bytes) -> None:
    """Before anything is uploaded in vain."""
    _set_rules(site, submissions_per_day=1)
    with site.client(site.token()) as client:
        assert send(client, archive).status_code == 202
    with ann(site) as browser:
        page = browser.get(f"{BOARD}/submit").text
    assert re.search(
        r"Team lab has sent what it may to test within 24 hours \(1\); .* possible at 20[\d-]+ [\d:]+ UTC\.", page
    )


def test_the_form_takes_every_name_that_the_server_takes(site: Site) -> None:
    """The pattern of the field is the server's rule."""
    with ann(site) as browser:
        found = re.search(r'id="method"[^>]* pattern="([^"]+)"', browser.get(f"{BOARD}/submit").text)
    assert found
    for name, usable in (
        ("form.m_1", True),
        ("a-b", True),
        ("-a", False),
        ("A", False),
        ("a" * 64, True),
        ("a" * 65, False),
    ):
        assert bool(re.fullmatch(found[1], name)) == usable


def test_a_method_takes_what_is_said_of_it_later(site: Site, archive: bytes) -> None:
    """A new name and description replace the old ones, with a trace; what is left out stays."""
    params = {"benchmark": "cs3d", "phase": "test", "method": "ours"}
    shown = [
        {},
        {"method_name": "Ours", "description": "A network."},
        {"method_name": "Ours, larger"},
        {"method_name": "Ours, larger"},
    ]
    with site.client(site.token()) as client:
        names = [
            client.post("/api/v1/submissions", params={**params, **said}, content=archive, headers=ZIP).json()[
                "method_name"
            ]
            for said in shown
        ]
        refused = client.post(
            "/api/v1/submissions", params={**params, "paper_url": "javascript:alert(1)"}, content=archive, headers=ZIP
        )
    assert names == ["ours", "Ours", "Ours, larger", "Ours, larger"]
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid_field")
    assert "paper_url must be an address like https://example.org" in refused.json()["detail"]
    with site.services.snapshot() as session:
        changes = session.scalars(
            sa.select(AuditEvent.detail).where(AuditEvent.action == "method.changed").order_by(AuditEvent.id)
        )
        assert list(changes) == [{"name": "Ours", "description": "A network."}, {"name": "Ours, larger"}]


def test_a_method_has_links_to_its_paper_and_code(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """Sent with the form, shown on the leaderboard and the method's page, and in the leaderboard's JSON."""
    links = {"paper_url": "https://example.org/p?a=1&b=2", "code_url": " http://code.example/x "}
    with ann(site) as browser:
        csrf = csrf_of(browser.get(f"{BOARD}/submit").text)
        fields = {"csrf": csrf, "team": "lab", "method": "ours", **links}
        page = browser.post(f"{BOARD}/submit", data=fields, files={"predictions": ("p.zip", archive)})
        submission_id = str(page.url).rpartition("/")[2]
    score(submission_id)
    with site.client(site.token()) as client:
        published = {"publication": "published"}
        assert client.post(f"/api/v1/submissions/{submission_id}/publication", json=published).status_code == 200
        (row,) = client.get("/api/v1/leaderboards/cs3d/test").json()["rows"]
        pages = [client.get(path).text for path in (BOARD, "/methods/lab/ours")]
    assert (row["paper_url"], row["code_url"]) == ("https://example.org/p?a=1&b=2", "http://code.example/x")
    for shown in pages:
        assert 'href="https://example.org/p?a=1&amp;b=2" rel="nofollow noopener"' in shown
        assert 'href="http://code.example/x" rel="nofollow noopener"' in shown
