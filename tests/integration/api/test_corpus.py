"""The corpus of archives and prediction files, sent over HTTP and judged by the worker: the codes in the file names.

All of them in the embedded shape; in the scale-out one, with its database and blobs, one for each set of codes. The same
files pass through `read_predictions` and `cs3d validate` in tests/unit/intake/test_corpus.py.
"""

import io
import json
import uuid
import zipfile
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from server import benchmarks
from server.services import Services
from server.settings import Settings
from tests.data.corpus_archives import IMAGES
from tests.data.corpus_predictions import IMAGE
from tests.data.make_corpus import DATA, expected_codes
from tests.integration.site import Site, populate, running_site
from tests.services.fixtures import settings_of
from tests.services.installation import SMALL_CASE
from worker.evaluation import evaluate_submission
from worker.sandbox import Sandbox

ARCHIVES = sorted((DATA / "archives").glob("*/*.zip"))
PREDICTIONS = sorted((DATA / "predictions").glob("*/*.json"))


EMBEDDED = pytest.mark.parametrize("corpus_site", ["embedded"], indirect=True)
SCALE_OUT = pytest.mark.parametrize("corpus_site", ["scale_out"], indirect=True)


def named(path: Path) -> str:
    """Name a file of the corpus, without its codes."""
    return f"{path.parent.name}-{path.name.split('.')[0]}"


def one_of_each() -> list[Path]:
    """Choose the first file of each set of codes, of archives and of prediction files."""
    files = reversed([*ARCHIVES, *PREDICTIONS])
    first = {(path.parent.parent.name, path.parent.name, expected_codes(path)): path for path in files}
    return sorted(first.values())


def _add_phase(services: Services, slug: str, images: tuple[str, ...], folder: Path) -> None:
    """Make a phase whose ground truth is the corpus's images, with a camera and without objects."""
    camera = json.loads(next((SMALL_CASE / "gt").iterdir()).read_bytes())
    (folder / slug).mkdir()
    for image in images:
        document = {**camera, "objects": [], "ignore": []}
        (folder / slug / f"{image}_gtBbox3d.json").write_text(json.dumps(document))
    with services.transaction() as session:
        phase = benchmarks.create_phase(
            session,
            benchmark=benchmarks.find_benchmark(session, "cs3d"),
            slug=slug,
            title=slug.title(),
            submissions_per_day=10_000,
            rejections_per_day=10_000,
            actor="admin:test",
        )
        benchmarks.import_ground_truth(session, services.blobs, phase=phase, source=folder / slug, actor="admin:test")


@pytest.fixture(scope="module")
def corpus_site(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[Site]:
    """Give a running application of a shape with one phase for the archives and one for the prediction files.

    Nobody is behind the broker's address: the test asks the worker itself.
    """
    folder = tmp_path_factory.mktemp("corpus")
    nobody = f"redis+socket://{folder / 'nobody.sock'}"
    shape_settings = settings_of(request.param, folder, request)
    services = Services.from_settings(
        Settings(
            data_dir=folder / "data", broker_url=nobody, broker_timeout_s=0.1, disk_floor_bytes=0, **shape_settings
        )
    )
    populate(services)
    _add_phase(services, "archives", IMAGES, folder)
    _add_phase(services, "predictions", (IMAGE,), folder)
    with running_site(services) as site:
        yield site
    services.close()


@pytest.fixture(scope="module")
def corpus_client(corpus_site: Site) -> Iterator[httpx.Client]:
    """Give a client of Ann's."""
    with corpus_site.client(corpus_site.token()) as client:
        yield client


@pytest.fixture(scope="module")
def corpus_sandbox() -> Iterator[Sandbox]:
    """Give the worker's scoring process."""
    sandbox = Sandbox()
    sandbox.start()
    yield sandbox
    sandbox.kill()


def judged(site: Site, client: httpx.Client, sandbox: Sandbox, phase: str, archive: bytes) -> tuple[bool, list[str]]:
    """Send an archive; say whether it is accepted in the end, and with which codes."""
    response = client.post(
        "/api/v1/submissions",
        params={"benchmark": "cs3d", "phase": phase, "method": "corpus"},
        content=archive,
        headers={"Content-Type": "application/zip"},
    )
    document = response.json()
    if response.status_code == 422:
        assert document["code"] == "archive_refused"
    else:
        assert response.status_code == 202
        evaluate_submission(site.services, sandbox, uuid.UUID(document["id"]), worker="test")
        document = client.get(document["links"]["self"]).json()
        assert document["state"] in {"scored", "rejected"}
    return document.get("state") == "scored", sorted(group["code"] for group in document["report"]["groups"])


def expected(path: Path) -> tuple[bool, list[str]]:
    """Read from a file's name whether it is accepted, and with which codes."""
    return path.parent.name == "accept", list(expected_codes(path))


def zipped(path: Path) -> bytes:
    """Pack one prediction file."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{IMAGE}_predBbox3d.json", path.read_bytes())
    return buffer.getvalue()


@EMBEDDED
@pytest.mark.parametrize("path", ARCHIVES, ids=named)
def test_archive(path: Path, corpus_site: Site, corpus_client: httpx.Client, corpus_sandbox: Sandbox) -> None:
    """An archive is refused at the door or by the worker, or scored, with exactly the codes in its name."""
    result = judged(corpus_site, corpus_client, corpus_sandbox, "archives", path.read_bytes())
    assert result == expected(path)


@EMBEDDED
@pytest.mark.parametrize("path", PREDICTIONS, ids=named)
def test_predictions(path: Path, corpus_site: Site, corpus_client: httpx.Client, corpus_sandbox: Sandbox) -> None:
    """A prediction file, zipped, is rejected by the worker or scored with exactly the codes in its name."""
    result = judged(corpus_site, corpus_client, corpus_sandbox, "predictions", zipped(path))
    assert result == expected(path)


@SCALE_OUT
@pytest.mark.parametrize("path", one_of_each(), ids=named)
def test_one_of_each(path: Path, corpus_site: Site, corpus_client: httpx.Client, corpus_sandbox: Sandbox) -> None:
    """With another database and other blobs, each set of codes comes out the same."""
    phase = path.parent.parent.name
    archive = path.read_bytes() if phase == "archives" else zipped(path)
    assert judged(corpus_site, corpus_client, corpus_sandbox, phase, archive) == expected(path)
