"""Login sessions end for whoever holds their cookie."""

import httpx
import sqlalchemy as sa

from server.models import AuditEvent
from tests.integration.pages.test_pages import ann, csrf_of
from tests.integration.site import PASSWORD, Site


def _goes_to_login(client: httpx.Client) -> bool:
    return client.get("/account", follow_redirects=False).status_code == 303


def test_logging_out_ends_a_stolen_cookie(site: Site) -> None:
    """After a log-out a copy of the session's cookie opens nothing; nor does any other session of the user."""
    with ann(site) as client, ann(site) as elsewhere, httpx.Client(base_url=site.url, timeout=30) as thief:
        thief.cookies.update(client.cookies)
        assert not _goes_to_login(thief)
        client.post("/logout", data={"csrf": csrf_of(client.get("/account").text)})
        assert _goes_to_login(thief)
        assert _goes_to_login(elsewhere)
    with ann(site) as again:
        assert not _goes_to_login(again)


NEW = "another horse, another battery"


def _change(client: httpx.Client, current: str, new: str) -> httpx.Response:
    csrf = csrf_of(client.get("/account").text)
    return client.post("/account/password", data={"csrf": csrf, "current": current, "new": new})


def test_a_new_password_ends_every_other_session(site: Site) -> None:
    """Who changes it stays logged in; from then on the new one opens the account, and the old one nothing."""
    with ann(site) as client, ann(site) as elsewhere:
        changed = _change(client, PASSWORD, NEW)
        assert changed.status_code == 200
        assert "Your password is changed" in changed.text
        assert not _goes_to_login(client)
        assert _goes_to_login(elsewhere)
        refused = elsewhere.post(
            "/login",
            data={"csrf": csrf_of(elsewhere.get("/login").text), "email": "ann@example.org", "password": PASSWORD},
        )
        assert refused.status_code == 401
        with site.services.snapshot() as session:
            last = session.scalars(sa.select(AuditEvent).order_by(AuditEvent.id.desc())).first()
            assert last is not None
            assert last.action == "user.password_set"
            assert last.actor.startswith("user:")
        assert _change(client, NEW, PASSWORD).status_code == 200
    with ann(site) as again:
        assert not _goes_to_login(again)


def test_a_password_is_not_changed_by_who_does_not_know_it(site: Site) -> None:
    """Whoever finds an open browser; nor is it by a form without its token, or without a login, or to a short one."""
    with ann(site) as client:
        wrong = _change(client, "a guess at the password", NEW)
        assert (wrong.status_code, "The current password is wrong." in wrong.text) == (401, True)
        short = _change(client, PASSWORD, "short")
        assert (short.status_code, "at least 10 characters" in short.text) == (422, True)
        fields = {"csrf": "x", "current": PASSWORD, "new": NEW}
        assert client.post("/account/password", data=fields).status_code == 403
    with httpx.Client(base_url=site.url, timeout=30) as nobody:
        csrf = csrf_of(nobody.get("/login").text)
        sent = nobody.post("/account/password", data={**fields, "csrf": csrf})
        assert (sent.status_code, sent.headers["location"]) == (303, "/login")
    with ann(site) as again:
        assert not _goes_to_login(again)


def test_guesses_at_a_password_are_slowed_down(site: Site) -> None:
    """In an open browser, too: after twenty wrong ones in a minute even the right one has to wait."""
    with ann(site) as client:
        form = {"csrf": csrf_of(client.get("/account").text), "current": "a guess", "new": NEW}
        guesses = [client.post("/account/password", data=form).status_code for _ in range(20)]
        refused = client.post("/account/password", data={**form, "current": PASSWORD})
        assert not _goes_to_login(client)
    assert guesses == [401] * 20
    assert refused.status_code == 429
