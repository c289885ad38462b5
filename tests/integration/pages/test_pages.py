"""Pages as a browser without JavaScript meets them: sessions, forms, who sees what, headers."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import httpx
import pytest

from tests.integration.api.test_following import own, zip_with
from tests.integration.api.test_leaderboards import NOTHING_FOUND, published
from tests.integration.site import PASSWORD, Site, send

Score = Callable[[str], None]

BOARD = "/benchmarks/cs3d/test"


def csrf_of(page: str) -> str:
    """Find the CSRF token of a page's forms."""
    found = re.search(r'name="csrf" value="([^"]+)"', page)
    assert found
    return found[1]


@contextmanager
def ann(site: Site) -> Iterator[httpx.Client]:
    """Log in as Ann."""
    with httpx.Client(base_url=site.url, follow_redirects=True, timeout=30) as client:
        token = csrf_of(client.get("/login").text)
        page = client.post(
            "/login", data={"csrf": token, "email": "ann@example.org", "password": PASSWORD, "next": "/"}
        )
        assert "Log out" in page.text
        yield client


def test_log_in_and_out(site: Site) -> None:
    """The session cookie is out of reach of scripts and other sites; after logging out it opens nothing."""
    with ann(site) as client:
        cookie = client.post(
            "/login",
            data={
                "csrf": csrf_of(client.get("/login").text),
                "email": "ann@example.org",
                "password": PASSWORD,
                "next": "//evil.example",
            },
            follow_redirects=False,
        )
        assert {"httponly", "samesite=lax"} <= {
            part.strip().lower() for part in cookie.headers["set-cookie"].split(";")
        }
        # Only paths of this server are taken for the way back.
        assert cookie.headers["location"] == "/"
        client.post("/logout", data={"csrf": csrf_of(client.get("/account").text)})
        assert client.get("/account", follow_redirects=False).headers["location"] == "/login?next=/account"


@pytest.mark.parametrize("field", ["email", "password"])
def test_a_wrong_login_does_not_say_what_is_wrong(site: Site, field: str) -> None:
    """A wrong address and a wrong password get the same answer."""
    with httpx.Client(base_url=site.url, timeout=30) as client:
        good = {"csrf": csrf_of(client.get("/login").text), "email": "ann@example.org", "password": PASSWORD}
        response = client.post("/login", data={**good, field: "wrong@example.org"})
    assert response.status_code == 401
    assert "e-mail address or password is wrong" in response.text


def test_many_wrong_logins_are_slowed_down(site: Site) -> None:
    """After twenty failures in a minute the address gets 429 with Retry-After, the right password included."""
    with httpx.Client(base_url=site.url, timeout=30) as client:
        form = {"csrf": csrf_of(client.get("/login").text), "email": "nobody@example.org", "password": "wrong"}
        statuses = [client.post("/login", data=form).status_code for _ in range(20)]
        refused = client.post("/login", data={**form, "email": "ann@example.org", "password": PASSWORD})
    assert statuses == [401] * 20
    assert refused.status_code == 429
    assert int(refused.headers["retry-after"]) > 0


@pytest.mark.parametrize(
    "change",
    [{"csrf": ""}, {"csrf": "wrong"}, {"sec-fetch-site": "cross-site"}],
    ids=["missing", "wrong", "other site"],
)
def test_forms_of_other_sites_change_nothing(site: Site, change: dict[str, str]) -> None:
    """A form without this session's token, or sent from another site, is 403 and does nothing."""
    with ann(site) as client:
        fields = {"csrf": csrf_of(client.get("/account").text), "name": "n", "team": "lab", "days": "90"}
        headers = {name: value for name, value in change.items() if name != "csrf"}
        fields |= {name: value for name, value in change.items() if name == "csrf"}
        response = client.post("/account/tokens", data=fields, headers=headers)
        assert response.status_code == 403
        assert "You have no tokens." in client.get("/account").text


def test_the_api_needs_the_token_from_a_session(site: Site, archive: bytes) -> None:
    """A cookie alone reads but changes nothing; with the session's CSRF token in its header it may send."""
    with ann(site) as client:
        csrf = csrf_of(client.get("/account").text)
        assert client.get("/api/v1/submissions").status_code == 200
        refused = send(client, archive)
        assert (refused.status_code, refused.json()["code"]) == (403, "csrf_failed")
        assert send(client, archive, X_CSRF_Token=csrf).status_code == 202


def test_a_forged_session_is_nobody(site: Site) -> None:
    """A cookie that is changed in one letter is no session."""
    with ann(site) as client:
        client.cookies.set("session", client.cookies["session"][:-2] + "AA", domain="127.0.0.1")
        assert client.get("/account", follow_redirects=False).status_code == 303


def test_tokens_are_made_shown_once_and_revoked(site: Site) -> None:
    """A new token's secret is on the page once, works at once, and is useless after it is revoked."""
    with ann(site) as client:
        fields = {"csrf": csrf_of(client.get("/account").text), "name": "laptop", "team": "lab", "days": "90"}
        made = client.post("/account/tokens", data=fields)
        secret = re.search(r'<code id="secret">([^<]+)</code>', made.text)
        assert (made.status_code, made.headers["cache-control"]) == (201, "no-store")
        assert secret
        with site.client(secret[1]) as api:
            assert api.get("/api/v1/submissions").status_code == 200
            page = client.get("/account").text
            assert secret[1] not in page
            revoke = re.search(r'action="(/account/tokens/\d+/revoke)"', page)
            assert revoke
            client.post(revoke[1], data={"csrf": csrf_of(page)})
            assert api.get("/api/v1/submissions").status_code == 401


def test_a_plain_form_sends_an_archive(site: Site, archive: bytes) -> None:
    """The multipart form works without JavaScript; problems are shown on the form with what was typed."""
    with ann(site) as client:
        csrf = csrf_of(client.get(f"{BOARD}/submit").text)
        fields = {"csrf": csrf, "team": "lab", "method": "ours", "method_name": "Ours", "description": ""}
        sent = client.post(f"{BOARD}/submit", data=fields, files={"predictions": ("p.zip", archive)})
        assert sent.url.path.startswith("/submissions/")
        assert "Ours" in sent.text
        refused = client.post(f"{BOARD}/submit", data=fields, files={"predictions": ("p.zip", b"no zip")})
        assert refused.status_code == 422
        assert "not_a_zip" in refused.text
        assert 'value="ours"' in refused.text
        forged = client.post(f"{BOARD}/submit", data={**fields, "csrf": "x"}, files={"predictions": ("p.zip", archive)})
        assert forged.status_code == 403


def test_private_submissions_do_not_exist_for_visitors(site: Site, archive: bytes, score: Score) -> None:
    """A visitor gets 404 for a private submission and its method, and the scores once it is published."""
    with site.client(site.token()) as api, site.client() as visitor, ann(site) as client:
        document = send(api, archive).json()
        score(document["id"])
        page = document["links"]["page"]
        assert visitor.get(page).status_code == visitor.get("/methods/lab/ours").status_code == 404
        assert visitor.get(BOARD).text.count("<tr") == 0
        client.post(f"{page}/publication", data={"csrf": csrf_of(client.get(page).text), "publication": "published"})
        shown = visitor.get(page)
        assert shown.status_code == 200
        assert api.get(document["links"]["self"]).json()["signature"] in visitor.get("/methods/lab/ours").text
        # The team's facts stay with the team.
        assert document["predictions"]["sha256"] in client.get(page).text
        assert document["predictions"]["sha256"] not in shown.text
        assert "What was found in the files" not in shown.text


def test_the_leaderboard_sorts_and_ranks(site: Site, archive: bytes, score: Score) -> None:
    """Equal methods share rank 1; columns sort both ways by the address; unknown choices fall back."""
    token = site.token()
    for method, body in (("first", archive), ("worst", zip_with(NOTHING_FOUND)), ("second", archive)):
        published(site, token, body, method, score)
    with site.client() as visitor:
        board = visitor.get(BOARD).text
        assert re.findall(r'<td class="rank">(\d+)', board) == ["1", "1", "3"]
        assert 'aria-sort="ascending"' in board
        ascending = visitor.get(BOARD, params={"sort": "mds", "order": "asc"}).text
        assert re.findall(r'<td class="rank">(\d+)', ascending) == ["3", "1", "1"]
        odd = visitor.get(BOARD, params={"sort": "'\"><script>", "metric": "no", "class": "no", "distance": "no"})
        assert odd.status_code == 200
        assert "<script>" not in odd.text


def test_two_methods_are_compared(site: Site, archive: bytes, score: Score) -> None:
    """Differences are the second method's less the first's; a submission that does not rank has no page."""
    token = site.token()
    best = published(site, token, archive, "best", score)
    worst = published(site, token, zip_with(NOTHING_FOUND), "worst", score)
    with site.client() as visitor:
        page = visitor.get(f"{BOARD}/compare", params={"a": best, "b": worst}).text
        mds = 100 * visitor.get("/api/v1/leaderboards/cs3d/test").json()["rows"][0]["mds"]
        assert visitor.get(f"{BOARD}/compare", params={"a": "no", "b": "no"}).status_code == 404
    row = re.search(r'<th scope="row" class="sticky">mDS</th>(.*?)</tr>', page, re.DOTALL)
    assert row
    # The worst finds nothing: its mDS is 0, the difference all of the best one's.
    cells = re.findall(r'<td class="number">([^<]*)</td>', row[1])
    assert cells[:3] == [f"{mds:.2f}", "0.00", f"−{mds:.2f}"]
    assert "the difference of mDS alone has an interval and a p-value" in page
    signatures = re.findall(r'<code class="signature">([^<]*)</code>', page)
    with site.client() as visitor:
        rows = {row["submission_id"]: row for row in visitor.get("/api/v1/leaderboards/cs3d/test").json()["rows"]}
    assert signatures == [rows[best]["signature"], rows[worst]["signature"]]
    # The best finds bicycles in one depth bin only; a class that is not found at all needs no word.
    assert re.findall(r">([^<]*): true positives in fewer than two depth bins", page) == ["best, bicycle"]
    # Two images are too few to say how far the difference can be trusted.
    assert row[1].count('<span class="undefined">n/a</span>') == 2
    assert "n/a" in page


def test_undefined_is_said(site: Site, archive: bytes, score: Score) -> None:
    """A class without ground truth shows n/a, never 0: the small case has none of train. A 0 that a rule makes is explained."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        score(document["id"])
        results = client.get(f"{own(document)}/results").json()
        undefined = [one["label"] for one in results["classes"] if one["ap"] is None]
        assert undefined
    with ann(site) as browser:
        page = browser.get(document["links"]["page"]).text
    for label in undefined:
        row = re.search(rf"<span>{label}</span></span></th>(.*?)</tr>", page, re.DOTALL)
        assert row
        # Six metrics and the working point.
        assert row[1].count("n/a") == 7
    # Half of the bicycles are found, all in one depth bin.
    assert "bicycle: true positives in fewer than two depth bins" in page


def test_what_matters_stands_above_the_scores(site: Site, score: Score) -> None:
    """A warning is not left to the end of a long page; beside the score stands how far it can be trusted."""
    with site.client(site.token()) as client:
        document = send(client, zip_with(NOTHING_FOUND)).json()
        score(document["id"])
    with ann(site) as browser:
        page = browser.get(document["links"]["page"]).text
    warning, interval = page.index("No file has a box of an evaluated class."), page.index("confidence interval of mDS")
    assert warning < interval < page.index('id="classes-caption"')
    # Two images are too few for one.
    assert "too few images or boxes for one that could be trusted" in page


@pytest.mark.parametrize("path", ["/", BOARD, "/login", "/problems", "/nothing", "/static/base.css", "/favicon.ico"])
def test_every_answer_is_guarded(site: Site, path: str) -> None:
    """Every answer forbids foreign content, framing and guessing of types; no page has inline script or style."""
    with site.client() as visitor:
        response = visitor.get(path)
    policy = response.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert response.headers["x-content-type-options"] == "nosniff"
    assert not re.search(r"<script(?![^>]*\ssrc=)|<style|\sstyle=|\son[a-z]+=", response.text) or path.startswith("/s")


def test_names_are_text(site: Site, archive: bytes, score: Score) -> None:
    """A method called like markup is shown as text everywhere."""
    name = "<img src=x onerror=alert(1)>"
    with site.client(site.token()) as client:
        params = {"benchmark": "cs3d", "phase": "test", "method": "ours", "method_name": name}
        document = client.post(
            "/api/v1/submissions", params=params, content=archive, headers={"Content-Type": "application/zip"}
        ).json()
        score(document["id"])
        client.post(f"{own(document)}/publication", json={"publication": "published"})
        for path in ("/", BOARD, document["links"]["page"], "/methods/lab/ours"):
            page = client.get(path).text
            assert name not in page
            assert "&lt;img" in page


def test_static_files_are_kept_by_digest(site: Site) -> None:
    """Files asked for by digest may be kept for ever, others must be asked for again."""
    with site.client() as visitor:
        address = re.search(r'href="(/static/base\.css\?v=[0-9a-f]+)"', visitor.get("/").text)
        assert address
        assert "immutable" in visitor.get(address[1]).headers["cache-control"]
        assert visitor.get("/static/base.css").headers["cache-control"] == "no-cache"
