"""Answers that are kept for those who ask again: as fast as they may be, never staler than the database."""

import concurrent.futures
from collections.abc import Callable

import httpx
import pytest
import sqlalchemy as sa

from server import accounts
from server.models import Membership, Method, Submission, Token, User
from server.services import Services
from tests.integration.site import Site, send

Change = Callable[[Services], None]


def own(document: dict[str, str]) -> str:
    """Give the address of a submission."""
    return f"/api/v1/submissions/{document['id']}"


def asked_twice(client: httpx.Client, archive: bytes) -> str:
    """Send a submission and ask for it twice, so that its answer is kept and was used; give its address."""
    address = own(send(client, archive).json())
    assert client.get(address).content == client.get(address).content
    return address


def execute(services: Services, statement: sa.UpdateBase) -> None:
    """Change rows behind the back of every process that keeps answers."""
    with services.transaction() as session:
        session.execute(statement)


def test_kept_answer_is_like_the_first(site: Site, archive: bytes) -> None:
    """Asking again gives the same status, body and headers, the security headers among them."""
    with site.client(site.token()) as client:
        address = own(send(client, archive).json())
        first, again = client.get(address), client.get(address)
    different = {"date"}
    assert (again.status_code, again.content) == (200, first.content)
    assert {name: value for name, value in again.headers.items() if name not in different} == {
        name: value for name, value in first.headers.items() if name not in different
    }
    assert "content-security-policy" in again.headers


@pytest.mark.parametrize(("said", "secure"), [("http", False), ("https", True), ("ws", False), ("wss", False)])
def test_kept_answer_comes_by_every_scheme_a_proxy_says(site: Site, archive: bytes, said: str, *, secure: bool) -> None:
    """X-Forwarded-Proto of a trusted proxy, a scheme of web sockets included, is no obstacle; https alone adds HSTS."""
    with site.client(site.token()) as client:
        again = client.get(asked_twice(client, archive), headers={"X-Forwarded-Proto": said})
    assert again.status_code == 200
    assert ("strict-transport-security" in again.headers) is secure


def test_kept_answer_is_for_its_token_alone(site: Site, archive: bytes) -> None:
    """Another team's token and no token find nothing where an answer is kept."""
    stranger = site.stranger()
    with site.client(site.token()) as client, site.client(stranger) as other, site.client() as nobody:
        address = asked_twice(client, archive)
        assert other.get(address).status_code == 404
        assert nobody.get(address).status_code == 404


def revoke(services: Services) -> None:
    """End every token in good order."""
    with services.transaction() as session:
        for token in session.scalars(sa.select(Token)):
            accounts.revoke_token(session, token, actor="admin:test")


def disable(services: Services) -> None:
    """Disable every user."""
    execute(services, sa.update(User).values(disabled_at=sa.select(sa.func.min(User.created_at)).scalar_subquery()))


def leave(services: Services) -> None:
    """Empty every team."""
    execute(services, sa.delete(Membership))


def expire(services: Services) -> None:
    """Let every token end at the moment it was made."""
    execute(services, sa.update(Token).values(expires_at=Token.created_at))


@pytest.mark.parametrize("change", [revoke, disable, leave, expire])
def test_token_that_ends_ends_at_once(site: Site, archive: bytes, change: Change) -> None:
    """A token that is revoked, expired, or whose user is disabled or left the team, gets no kept answer."""
    with site.client(site.token()) as client:
        address = asked_twice(client, archive)
        change(site.services)
        assert client.get(address).status_code == 401


def test_change_shows_at_once(site: Site, archive: bytes) -> None:
    """The first poll after a commit shows what was committed, to who gave a version and who did not."""
    with site.client(site.token()) as client:
        address = asked_twice(client, archive)
        etag = client.get(address).headers["etag"]
        execute(
            site.services, sa.update(Submission).values(stage="validating", images_done=1, images_total=2, version=7)
        )
        assert client.get(address, headers={"If-None-Match": etag}).json()["progress"]["images_done"] == 1
        assert client.get(address).json()["progress"]["images_done"] == 1


def test_score_in_force_shows_at_once(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """A submission that is scored meanwhile is shown with its score."""
    with site.client(site.token()) as client:
        address = asked_twice(client, archive)
        score(address.rsplit("/", 1)[-1])
        assert client.get(address).json()["state"] == "scored"
        assert client.get(address).json()["mds"] is not None


def test_many_who_ask_at_once_share_a_query(site: Site, archive: bytes) -> None:
    """Polls of several submissions at the same time each get their own answer."""
    token = site.token()
    with site.client(token) as client, concurrent.futures.ThreadPoolExecutor(8) as pool:
        addresses = [own(send(client, archive, method=f"m{number}").json()) for number in range(4)]
        asked = [address for address in addresses for _ in range(10)]

        def ask(address: str) -> str:
            answer = httpx.get(site.url + address, headers={"Authorization": f"Bearer {token}"})
            found: str = answer.json()["links"]["self"]
            return found

        assert list(pool.map(ask, asked)) == asked


def test_unknown_way_of_writing_the_id_still_works(site: Site, archive: bytes) -> None:
    """An id in capitals is the same submission, kept or not."""
    with site.client(site.token()) as client:
        address = asked_twice(client, archive)
        prefix, _, submission_id = address.rpartition("/")
        assert client.get(f"{prefix}/{submission_id.upper()}").json()["links"]["self"] == address


def test_renamed_method_shows_when_the_answer_is_old(
    site: Site, archive: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names are not asked for at every poll; an answer older than its longest age is rendered again."""
    with site.client(site.token()) as client:
        address = asked_twice(client, archive)
        execute(site.services, sa.update(Method).values(name="Renamed"))
        monkeypatch.setattr("server.api.polling.MAX_AGE_S", 0.0)
        assert client.get(address).json()["method_name"] == "Renamed"
