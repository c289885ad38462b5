"""One web application per test, in both shapes.

Embedded: SQLite, a folder, and nobody behind the broker's address, for an upload must not need one. Scale-out:
PostgreSQL, an S3 server and Redis.
"""

import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from server.models import Score
from server.services import Services
from server.settings import Settings
from tests.integration.site import Site, populate, running_site
from tests.services.fixtures import Shape
from tests.services.installation import SMALL_CASE, zip_of
from worker.evaluation import evaluate_submission
from worker.resampling import resample_score
from worker.sandbox import Sandbox


@pytest.fixture(scope="session")
def archive() -> bytes:
    """Give predictions for the two images of the small case."""
    return zip_of(SMALL_CASE / "pred")


@pytest.fixture
def quiet_services(
    shape: Shape, shape_settings: dict[str, Any], tmp_path: Path, request: pytest.FixtureRequest
) -> Iterator[Services]:
    """Give services on an empty installation without workers."""
    if shape == "embedded":
        broker_url = f"redis+socket://{tmp_path / 'nobody.sock'}"
    else:
        broker_url = request.getfixturevalue("broker").url
    settings = Settings(
        data_dir=tmp_path / "data", broker_url=broker_url, broker_timeout_s=0.2, disk_floor_bytes=0, **shape_settings
    )
    services = Services.from_settings(settings)
    populate(services)
    yield services
    services.close()


@pytest.fixture
def site(quiet_services: Services) -> Iterator[Site]:
    """Give a running application with team `lab` and phase `cs3d/test`."""
    with running_site(quiet_services) as site:
        yield site


@pytest.fixture(scope="session")
def sandbox() -> Iterator[Sandbox]:
    """Give the worker's scoring process."""
    sandbox = Sandbox()
    sandbox.start()
    yield sandbox
    sandbox.kill()


@pytest.fixture
def score(site: Site, sandbox: Sandbox) -> Callable[[str], None]:
    """Give a function that does a worker's work on one submission and on what follows its score."""

    def work(submission_id: str) -> None:
        evaluate_submission(site.services, sandbox, uuid.UUID(submission_id), worker="test")
        with site.services.snapshot() as session:
            score_id = session.scalar(sa.select(Score.id).where(Score.submission_id == uuid.UUID(submission_id)))
        if score_id is not None:
            resample_score(site.services, sandbox, score_id, worker="test")

    return work
