"""Looking at submissions: state, conditional requests, waiting, events, results, publication, cancellation."""

import io
import json
import threading
import zipfile
from collections.abc import Callable

import httpx
import pytest
import sqlalchemy as sa

from server.models import Score as ScoreRow
from server.models import SubmissionState
from tests.integration.site import Site, send
from tests.services.installation import SMALL_CASE
from tests.services.processes import wait_until

Score = Callable[[str], None]

EXPECTED_MDS = json.loads((SMALL_CASE / "expected.json").read_text())["mDetection_Score"]
"""What the reference implementation gives for the small case."""


def zip_with(files: dict[str, bytes]) -> bytes:
    """Pack files."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def own(document: dict[str, str]) -> str:
    """Give the address of a submission."""
    return f"/api/v1/submissions/{document['id']}"


def test_unchanged_is_304_and_says_when_to_ask_again(site: Site, archive: bytes) -> None:
    """The ETag answers 304 until something changes; while the submission is not done, Retry-After is given."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        first = client.get(own(document))
        again = client.get(own(document), headers={"If-None-Match": first.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")
        assert int(first.headers["retry-after"]) == int(again.headers["retry-after"]) == 2
        client.post(f"{own(document)}/cancel")
        changed = client.get(own(document), headers={"If-None-Match": first.headers["etag"]})
    assert (changed.status_code, changed.json()["state"]) == (200, "cancelled")
    assert changed.json()["terminal"] is True
    assert "retry-after" not in changed.headers


def test_waiting_ends_with_the_change(site: Site, archive: bytes) -> None:
    """A long poll returns as soon as the submission differs from the version the client holds."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        etag = client.get(own(document)).headers["etag"]
        found: list[httpx.Response] = []

        def wait() -> None:
            with site.client(client.headers["authorization"].removeprefix("Bearer ")) as other:
                found.append(other.get(own(document), params={"wait": 30}, headers={"If-None-Match": etag}))

        waiting = threading.Thread(target=wait)
        waiting.start()
        client.post(f"{own(document)}/cancel")
        waiting.join(timeout=20)
    assert found[0].json()["state"] == "cancelled"


def test_waiting_in_vain_is_304(site: Site, archive: bytes) -> None:
    """A long poll that sees no change ends with 304 after the time it asked for."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        etag = client.get(own(document)).headers["etag"]
        response = client.get(own(document), params={"wait": 0.3}, headers={"If-None-Match": etag})
    assert response.status_code == 304


def test_events_tell_every_state_until_the_last(site: Site, archive: bytes, score: Score) -> None:
    """The event stream begins with the present state, tells changes and ends with the terminal state."""
    token = site.token()
    with site.client(token) as client:
        document = send(client, archive).json()
    states: list[str] = []

    def follow() -> None:
        with site.client(token) as client, client.stream("GET", f"{own(document)}/events") as stream:
            states.append(stream.headers["content-type"].partition(";")[0])
            data = (line.removeprefix("data:") for line in stream.iter_lines() if line.startswith("data:"))
            states.extend(json.loads(text)["state"] for text in data)

    following = threading.Thread(target=follow, daemon=True)
    following.start()
    wait_until(lambda: len(states) > 0, what="the stream's beginning")
    score(document["id"])
    following.join(timeout=30)
    assert states[0] == "text/event-stream"
    assert states[1] == "received"
    assert states[-1] == "scored"


def test_scored_results_are_the_references(site: Site, archive: bytes, score: Score) -> None:
    """Results carry every number with the signature, equal to the reference to 1e-9; before, 409 `not_scored`."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        early = client.get(f"{own(document)}/results")
        assert (early.status_code, early.json()["code"]) == (409, "not_scored")
        score(document["id"])
        done = client.get(own(document)).json()
        results = client.get(done["links"]["results"])
        again = client.get(done["links"]["results"], headers={"If-None-Match": results.headers["etag"]})
    assert (done["state"], done["progress"], done["report"]["images_found"]) == ("scored", None, 2)
    assert done["mds"] == pytest.approx(EXPECTED_MDS, abs=1e-9)
    assert results.json()["mds"] == done["mds"]
    assert results.json()["signature_text"].startswith("cityscapes3d:1|evaluator:")
    assert again.status_code == 304


def test_predictions_with_errors_are_rejected_with_a_report(site: Site, score: Score) -> None:
    """A well-framed archive without the images ends `rejected`; the report names every missing image."""
    with site.client(site.token()) as client:
        body = zip_with({"bonn_000000_000019_pred.json": b'{"objects": []}'})
        document = send(client, body).json()
        score(document["id"])
        done = client.get(own(document)).json()
    assert (done["state"], done["terminal"], done["mds"]) == ("rejected", True, None)
    # The case has two images; one of them is in the archive.
    groups = {group["code"]: group["count"] for group in done["report"]["groups"]}
    assert groups["missing_image"] == 1


def test_a_private_submission_does_not_exist_for_others(site: Site, archive: bytes, score: Score) -> None:
    """For anybody outside the team a private submission is 404 in every respect, exactly like one that is not there."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
    score(document["id"])
    for token in (None, site.stranger()):
        with site.client(token) as other:
            for path in ("", "/results", "/events"):
                assert other.get(own(document) + path).status_code == 404
            assert other.get("/api/v1/submissions/00000000-0000-0000-0000-000000000000").status_code == 404
            assert other.get("/api/v1/submissions/no-uuid").status_code == 404
    with site.client(site.stranger(email="m@example.org", team="staff", is_maintainer=True)) as maintainer:
        assert maintainer.get(own(document)).status_code == 200


def test_publishing_shows_scores_but_not_the_report(site: Site, archive: bytes, score: Score) -> None:
    """Once published, everybody sees the scores; report and cause of failure stay with the team. Withdrawn, it hides."""
    with site.client(site.token()) as client, site.client() as nobody:
        document = send(client, archive).json()
        early = client.post(f"{own(document)}/publication", json={"publication": "published"})
        assert (early.status_code, early.json()["code"]) == (409, "not_scored")
        score(document["id"])
        shown = client.post(f"{own(document)}/publication", json={"publication": "published"})
        assert (shown.status_code, shown.json()["publication"]) == (200, "published")
        public = nobody.get(own(document))
        assert (public.status_code, public.json()["report"]) == (200, None)
        assert public.json()["mds"] == pytest.approx(EXPECTED_MDS, abs=1e-9)
        assert nobody.get(f"{own(document)}/results").status_code == 200
        with site.client(site.stranger()) as other:
            refused = other.post(f"{own(document)}/publication", json={"publication": "withdrawn"})
            assert (refused.status_code, refused.json()["code"]) == (403, "forbidden")
        client.post(f"{own(document)}/publication", json={"publication": "withdrawn"})
        assert nobody.get(own(document)).status_code == 404


def test_a_version_differs_by_who_asks(site: Site, archive: bytes, score: Score) -> None:
    """The ETag of the team's view is not that of the public view, because the documents differ."""
    with site.client(site.token()) as client, site.client() as nobody:
        document = send(client, archive).json()
        score(document["id"])
        client.post(f"{own(document)}/publication", json={"publication": "published"})
        etag = client.get(own(document)).headers["etag"]
        assert nobody.get(own(document), headers={"If-None-Match": etag}).status_code == 200


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        (b"{", 400, "malformed_request"),
        (b"{}", 422, "invalid_request"),
        (b'{"publication": "shown"}', 422, "invalid_request"),
        (b'{"publication": "published", "more": 1}', 422, "invalid_request"),
    ],
)
def test_a_bad_publication_is_explained(site: Site, archive: bytes, body: bytes, status: int, code: str) -> None:
    """What is not the documented body is refused, naming the value."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        response = client.post(
            f"{own(document)}/publication", content=body, headers={"Content-Type": "application/json"}
        )
    assert (response.status_code, response.json()["code"]) == (status, code)


def test_a_scored_submission_cannot_be_cancelled(site: Site, archive: bytes, score: Score) -> None:
    """Cancelling what is done is 409 and changes nothing."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        score(document["id"])
        response = client.post(f"{own(document)}/cancel")
        assert (response.status_code, response.json()["code"]) == (409, "illegal_transition")
        assert client.get(own(document)).json()["state"] == "scored"


def test_the_list_is_the_teams_own(site: Site, archive: bytes) -> None:
    """The list holds the team's submissions, latest first, and nobody else's."""
    with site.client(site.token()) as client, site.client(site.stranger()) as other:
        sent = [send(client, archive, method=method).json()["id"] for method in ("one", "two")]
        assert [row["id"] for row in client.get("/api/v1/submissions").json()["submissions"]] == sent[::-1]
        assert other.get("/api/v1/submissions").json()["submissions"] == []
        chosen = client.get("/api/v1/submissions", params={"benchmark": "cs3d", "phase": "test", "limit": 1})
        assert [row["id"] for row in chosen.json()["submissions"]] == sent[1:]
        assert client.get("/api/v1/submissions", params={"phase": "test"}).status_code == 422


def test_the_list_can_be_filtered(site: Site, archive: bytes) -> None:
    """By state, method and phase, which hold together; what meets them all comes, latest first."""
    with site.client(site.token()) as client:
        first, ended, other = (send(client, archive, method=method).json() for method in ("one", "one", "two"))
        client.post(f"{own(ended)}/cancel").raise_for_status()

        def listed(**filters: str) -> list[str]:
            return [row["id"] for row in client.get("/api/v1/submissions", params=filters).json()["submissions"]]

        assert listed(state="received") == [other["id"], first["id"]]
        assert listed(state="cancelled") == [ended["id"]]
        assert listed(method="one") == [ended["id"], first["id"]]
        assert listed(method="one", state="received", benchmark="cs3d", phase="test") == [first["id"]]
        assert listed(state="scored") == listed(method="three") == []


def test_filters_that_cannot_be_are_refused(site: Site) -> None:
    """An unknown state is answered with the list of states, a method that none can be called with what one may be."""
    with site.client(site.token()) as client:
        state = client.get("/api/v1/submissions", params={"state": "done"})
        method = client.get("/api/v1/submissions", params={"method": "No Slug"})
        described = client.get("/api/v1/openapi.json").json()["paths"]["/api/v1/submissions"]["get"]["parameters"]
    assert (state.status_code, state.json()["code"]) == (422, "invalid_request")
    assert all(f"'{one}'" in state.json()["detail"] for one in SubmissionState)
    assert (method.status_code, method.json()["code"]) == (422, "invalid_field")
    assert all(parameter["description"] for parameter in described)


def test_a_revoked_token_opens_nothing(site: Site, archive: bytes) -> None:
    """A token that was revoked is refused at once."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        with site.services.transaction() as session:
            session.execute(sa.text("UPDATE token SET revoked_at = created_at"))
        assert client.get(own(document)).status_code == 401


@pytest.mark.parametrize(("method", "path"), [("GET", "/api/v1/nothing"), ("GET", "/api/v2")])
def test_unknown_addresses_are_problem_documents(site: Site, method: str, path: str) -> None:
    """An address that does not exist is a 404 problem document, a wrong method 405 with Allow."""
    with site.client() as client:
        response = client.request(method, path)
        assert (response.status_code, response.json()["code"]) == (404, "not_found")
        wrong = client.delete("/api/v1/benchmarks")
    assert (wrong.status_code, wrong.json()["code"], wrong.headers["allow"]) == (405, "method_not_allowed", "GET, HEAD")


@pytest.mark.parametrize("shape", ["embedded"], indirect=True)  # a bucket's bytes cannot be damaged in place
def test_unforeseen_errors_say_nothing_about_the_inside(site: Site, archive: bytes, score: Score) -> None:
    """Damaged scores in the blob store are a 500 problem document with a reference, and nothing about the inside."""
    with site.client(site.token()) as client:
        document = send(client, archive).json()
        score(document["id"])
        with site.services.snapshot() as session:
            sha256 = session.scalar(sa.select(ScoreRow.scores_sha256))
        assert sha256
        damaged = site.services.blobs.local_path(sha256)
        damaged.chmod(0o600)
        damaged.write_bytes(b"broken")
        response = client.get(f"{own(document)}/results")
    assert (response.status_code, response.json()["code"]) == (500, "internal_error")
    assert response.json()["instance"].startswith("urn:cs3d:error:")
    assert sha256 not in response.text
    assert "msgspec" not in response.text
    assert "default-src 'none'" in response.headers["content-security-policy"]


@pytest.mark.parametrize("shape", ["embedded"], indirect=True)  # PostgreSQL tells a missing table from one that is away
def test_a_database_that_is_away_is_503(site: Site) -> None:
    """While the database does not answer, so says the API, with a code that invites to come back."""
    with site.services.transaction() as session:
        session.execute(sa.text("DROP TABLE token"))
    with site.client("cs3d_any") as client:
        response = client.get("/api/v1/submissions")
    assert (response.status_code, response.json()["code"]) == (503, "unavailable")
