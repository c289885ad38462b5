"""Leaderboards and benchmarks, for everybody, as JSON and CSV."""

import csv
import io
from collections.abc import Callable
from pathlib import Path

import pytest

from client.main import main
from server import benchmarks
from tests.integration.api.test_following import EXPECTED_MDS, own, zip_with
from tests.integration.site import Site, send
from tests.services.installation import SMALL_CASE

BOARD = "/api/v1/leaderboards/cs3d/test"
NOTHING_FOUND = {f"bonn_00000{n}_000019_x.json": b'{"objects": []}' for n in (0, 1)}
"""Predictions for the small case that find nothing: every class with ground truth scores 0."""


def published(site: Site, token: str, archive: bytes, method: str, score: Callable[[str], None]) -> str:
    """Send, score and publish; give the id."""
    with site.client(token) as client:
        document = send(client, archive, method=method).json()
        score(document["id"])
        client.post(f"{own(document)}/publication", json={"publication": "published"}).raise_for_status()
    found: str = document["id"]
    return found


def test_ranks_are_shared_and_everybody_may_read(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """Two equal methods share rank 1 in the order of submission, the worse one is third; nobody needs a token."""
    token = site.token()
    first = published(site, token, archive, "first", score)
    worst = published(site, token, zip_with(NOTHING_FOUND), "worst", score)
    second = published(site, token, archive, "second", score)
    with site.client() as nobody:
        response = nobody.get(BOARD)
        document = response.json()
        again = nobody.get(BOARD, headers={"If-None-Match": response.headers["etag"]})
    assert (document["benchmark"], document["phase"], document["protocol"]) == ("cs3d", "test", "cityscapes3d")
    rows = [(row["rank"], row["submission_id"]) for row in document["rows"]]
    assert rows == [(1, first), (1, second), (3, worst)]
    assert document["rows"][0]["mds"] == pytest.approx(EXPECTED_MDS, abs=1e-9)
    assert list(document["rows"][0]["classes"]) == ["car", "truck", "bus", "train", "motorcycle", "bicycle"]
    assert (again.status_code, again.content) == (304, b"")


@pytest.mark.parametrize(("query", "headers"), [({"format": "csv"}, {}), ({}, {"Accept": "text/csv"})])
def test_csv_holds_the_same_numbers(
    *, site: Site, archive: bytes, score: Callable[[str], None], query: dict[str, str], headers: dict[str, str]
) -> None:
    """CSV has one row a method with the numbers of the JSON in full precision, undefined ones empty, and its times."""
    published(site, site.token(), archive, "ours", score)
    with site.client() as nobody:
        response = nobody.get(BOARD, params=query, headers=headers)
        row = nobody.get(BOARD).json()["rows"][0]
    assert response.headers["content-type"].startswith("text/csv")
    (line,) = csv.DictReader(io.StringIO(response.text))
    assert float(line["mds"]) == row["mds"]
    assert line["created_at"] == row["created_at"]
    for label, values in row["classes"].items():
        for metric, value in values.items():
            assert line[f"{label}_{metric}"] == ("" if value is None else repr(value))


def test_names_are_no_formulas_in_csv(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """A method whose name begins like a formula is written so that a spreadsheet shows it as text."""
    with site.client(site.token()) as client:
        params = {"benchmark": "cs3d", "phase": "test", "method": "ours", "method_name": "=1+1"}
        headers = {"Content-Type": "application/zip"}
        document = client.post("/api/v1/submissions", params=params, content=archive, headers=headers).json()
        score(document["id"])
        client.post(f"{own(document)}/publication", json={"publication": "published"})
        response = client.get(BOARD, params={"format": "csv"})
    (line,) = csv.DictReader(io.StringIO(response.text))
    assert line["method_name"] == "'=1+1"


def test_an_empty_leaderboard_is_no_error(site: Site) -> None:
    """Without published methods there are no rows, and the CSV has its header alone."""
    with site.client() as nobody:
        assert nobody.get(BOARD).json()["rows"] == []
        assert len(nobody.get(BOARD, params={"format": "csv"}).text.splitlines()) == 1
        assert nobody.get("/api/v1/leaderboards/cs3d/none").json()["code"] == "not_found"
        assert nobody.get(BOARD, params={"format": "xml"}).json()["code"] == "invalid_request"


def test_benchmarks_are_listed(site: Site) -> None:
    """The list shows phases with their rules and never anything of the ground truth but its size."""
    with site.client() as nobody:
        (benchmark,) = nobody.get("/api/v1/benchmarks").json()["benchmarks"]
    (phase,) = benchmark["phases"]
    assert (benchmark["slug"], phase["slug"], phase["is_open"], phase["images"]) == ("cs3d", "test", False, 2)


def test_the_images_of_a_hidden_phase_are_public(site: Site, tmp_path: Path) -> None:
    """Names and cameras, nothing else: what `cs3d validate --images` needs, for everybody."""
    with site.client() as nobody:
        response = nobody.get("/api/v1/benchmarks/cs3d/test/images")
        assert nobody.get("/api/v1/benchmarks/cs3d/none/images").status_code == 404
    document = response.json()
    assert document["images"] == ["bonn_000000_000019", "bonn_000001_000019"]
    assert set(document) == {"images", "intrinsics_px", "sensor_from_vehicle"}
    (tmp_path / "images.json").write_bytes(response.content)
    assert main(["validate", str(SMALL_CASE / "pred"), "--images", str(tmp_path / "images.json")]) == 0


def test_who_holds_the_image_list_is_answered_without_reading_it(site: Site) -> None:
    """With the version of If-None-Match the answer is 304 even when the store has lost the list."""
    address = "/api/v1/benchmarks/cs3d/test/images"
    with site.client() as nobody:
        etag = nobody.get(address).headers["etag"]
        with site.services.snapshot() as session:
            ground_truth = benchmarks.find_phase(session, "cs3d", "test").ground_truth
            assert ground_truth is not None
            site.services.blobs.delete(ground_truth.image_list_sha256)
        assert nobody.get(address, headers={"If-None-Match": '"other"'}).status_code == 404
        assert nobody.get(address, headers={"If-None-Match": etag}).status_code == 304
