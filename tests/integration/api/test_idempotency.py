"""Idempotency-Key: a request that is sent again is answered again, and a key stands for one request."""

import threading

import pytest
import sqlalchemy as sa

from server import accounts, benchmarks, submissions
from server.errors import IdempotencyMismatch
from tests.integration.api.test_sending import PARAMS, problem_of, recorded
from tests.integration.site import Site, send


def test_a_repeated_request_gives_the_same_submission(site: Site, archive: bytes) -> None:
    """The same Idempotency-Key gives the same submission, once recorded and once charged."""
    with site.client(site.token()) as client:
        first = send(client, archive, Idempotency_Key="run-7")
        second = send(client, archive, Idempotency_Key="run-7")
    assert (first.status_code, second.status_code) == (202, 202)
    assert first.json() == second.json()
    assert first.headers["location"] == second.headers["location"]
    assert recorded(site.services) == (1, 1)


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE phase SET opens_at = '2019-01-01 00:00:00.000000', closes_at = '2020-01-01 00:00:00.000000'",
        "UPDATE phase SET submissions_per_day = 1",
    ],
    ids=["closed", "used_up"],
)
def test_a_repeated_request_is_answered_whatever_changed_meanwhile(site: Site, archive: bytes, change: str) -> None:
    """When the phase has closed, or the quota is used up, a used key still gives its submission; a new one does not."""
    fields = {**PARAMS, "method": "ours"}
    with site.client(site.token()) as client:
        first = send(client, archive, Idempotency_Key="run-7")
        with site.services.transaction() as session:
            session.execute(sa.text(change))
        raw = send(client, archive, Idempotency_Key="run-7")
        form = client.post(
            "/api/v1/submissions",
            data=fields,
            files={"predictions": ("p.zip", archive)},
            headers={"Idempotency-Key": "run-7"},
        )
        new = send(client, archive, Idempotency_Key="run-8")
    assert (raw.status_code, form.status_code) == (202, 202)
    assert raw.json() == form.json() == first.json()
    assert (new.status_code, problem_of(new)["code"]) in {(409, "phase_closed"), (429, "quota_exceeded")}
    assert recorded(site.services) == (1, 1)


def test_simultaneous_requests_with_one_key_are_one_submission(site: Site, archive: bytes) -> None:
    """Five identical requests at once under one key make one submission."""
    token, found = site.token(), []

    def request() -> None:
        with site.client(token) as client:
            found.append(send(client, archive, Idempotency_Key="run-7").json()["id"])

    threads = [threading.Thread(target=request) for _ in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 5
    assert len(set(found)) == 1
    assert recorded(site.services) == (1, 1)


def test_a_key_stands_for_one_request(site: Site, archive: bytes) -> None:
    """A used key with another method or other bytes is 422."""
    with site.client(site.token()) as client:
        send(client, archive, Idempotency_Key="run-7")
        response = send(client, archive, method="theirs", Idempotency_Key="run-7")
    assert (response.status_code, problem_of(response)["code"]) == (422, "idempotency_mismatch")
    assert recorded(site.services) == (1, 1)


@pytest.mark.parametrize("other", ["method", "team", "predictions"])
def test_a_key_stands_for_one_request_also_when_raced(site: Site, archive: bytes, other: str) -> None:
    """A request that finds its key taken only when it is recorded is refused like one that finds it before."""
    site.stranger()
    with site.client(site.token()) as client:
        send(client, archive, Idempotency_Key="run-7")
    sent = archive + b"more" if other == "predictions" else archive
    with site.services.transaction() as session:
        user = accounts.find_user(session, "ann@example.org")
        team = accounts.find_team(session, "others" if other == "team" else "lab")
        accounts.add_member(session, team, user, actor="admin:test")
        with pytest.raises(IdempotencyMismatch):
            submissions.receive(
                session,
                phase=benchmarks.find_phase(session, "cs3d", "test"),
                team=team,
                user=user,
                method_slug="theirs" if other == "method" else "ours",
                predictions_sha256=site.services.blobs.put_bytes(sent),
                size_bytes=len(sent),
                file_name="predictions.zip",
                actor="user:1",
                idempotency_key="run-7",
            )
    assert recorded(site.services) == (1, 1)


def test_two_keys_are_none(site: Site, archive: bytes) -> None:
    """Two Idempotency-Keys in one request are 400: which of them is meant is not guessed."""
    keys = [("Content-Type", "application/zip"), ("Idempotency-Key", "a"), ("Idempotency-Key", "b")]
    with site.client(site.token()) as client:
        response = client.post("/api/v1/submissions", params=PARAMS, content=archive, headers=keys)
    assert (response.status_code, problem_of(response)["code"]) == (400, "malformed_request")
    assert recorded(site.services) == (0, 0)
