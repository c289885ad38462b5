"""Login sessions end for whoever holds their cookie."""

import httpx

from tests.integration.pages.test_pages import ann, csrf_of
from tests.integration.site import Site


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
