"""HEAD, and who is refused for wrong tokens."""

import pytest

from tests.integration.site import Site, send


@pytest.mark.parametrize(
    "path", ["/", "/login", "/benchmarks/cs3d/test", "/api/v1/leaderboards/cs3d/test", "/api/v1/openapi.json"]
)
def test_head_answers_what_get_answers_without_the_body(site: Site, path: str) -> None:
    """Status, type and length are those of GET."""
    with site.client() as client:
        got, head = client.get(path), client.head(path)
    assert (head.status_code, head.content) == (200, b"")
    for name in ("content-type", "content-security-policy"):
        assert head.headers[name] == got.headers[name]
    assert int(head.headers["content-length"]) == len(got.content)


def test_head_of_an_event_stream_ends_at_once(site: Site, archive: bytes) -> None:
    """The stream of a submission that nobody scores would stay open; its head does not."""
    with site.client(site.token()) as client:
        links = send(client, archive).json()["links"]
        head = client.head(links["events"], timeout=10)
        assert head.headers["content-type"].startswith("text/event-stream")
        assert client.head(links["self"]).headers["etag"]


def test_a_good_token_is_let_in_beside_many_bad_ones(site: Site) -> None:
    """After 20 wrong tokens in a minute (the limit) a wrong one is told to wait; a right one is not."""
    with site.client("cs3d_wrong") as stranger:
        answers = [stranger.get("/api/v1/submissions").status_code for _ in range(21)]
    assert answers == [401] * 20 + [429]
    with site.client(site.token()) as ann:
        assert ann.get("/api/v1/submissions").status_code == 200
