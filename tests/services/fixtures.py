"""Fixtures: real services, started once per session or test, and installations in both shapes.

Imported by tests/conftest.py, so every test has them. `installation` runs its test on both shapes.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, cast

import pytest

from server import database
from server.services import Services
from server.settings import Settings
from tests.services.broker import Broker
from tests.services.bucket import BucketServer
from tests.services.installation import QUICK, Installation
from tests.services.mail_sink import MailSink, running_mail_sink
from tests.services.postgresql import PostgresqlServer

Shape = Literal["embedded", "scale_out"]


@pytest.fixture(scope="session")
def postgresql() -> Iterator[PostgresqlServer]:
    """Give a running PostgreSQL server.

    Not below pytest's own folder: as root the server is another user, whom a second pytest run at its start shuts out.
    """
    with tempfile.TemporaryDirectory(prefix="cs3d-postgresql-") as name:
        server = PostgresqlServer(Path(name))
        server.start()
        yield server
        server.kill()


@pytest.fixture(scope="session")
def migrated_template(postgresql: PostgresqlServer) -> str:
    """Give the name of a migrated, empty database to clone."""
    name = postgresql.create_database()
    engine = database.create_engine(postgresql.url(name))
    database.migrate(engine)
    engine.dispose()
    return name


@pytest.fixture(scope="session")
def bucket_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BucketServer]:
    """Give a running S3-compatible server."""
    server = BucketServer(tmp_path_factory.mktemp("bucket"))
    server.start()
    yield server
    server.kill()


@pytest.fixture
def mail_sink() -> Iterator[MailSink]:
    """Give a running mail server."""
    with running_mail_sink() as sink:
        yield sink


@pytest.fixture(params=["embedded", "scale_out"])
def shape(request: pytest.FixtureRequest) -> Shape:
    """Run the test once per shape."""
    return cast("Shape", request.param)


@pytest.fixture
def shape_settings(shape: Shape, tmp_path: Path, request: pytest.FixtureRequest) -> dict[str, Any]:
    """Give what the shape sets, with its database migrated and its bucket made."""
    return settings_of(shape, tmp_path, request)


def settings_of(shape: Shape, folder: Path, request: pytest.FixtureRequest) -> dict[str, Any]:
    """Do the same for a fixture of a wider scope, whose data are in `folder`."""
    if shape == "embedded":
        settings = Settings(data_dir=folder / "data")
        engine = database.create_engine(settings.database)
        database.migrate(engine)
        engine.dispose()
        return {}
    postgresql: PostgresqlServer = request.getfixturevalue("postgresql")
    bucket_server: BucketServer = request.getfixturevalue("bucket_server")
    template: str = request.getfixturevalue("migrated_template")
    return {
        "database_url": postgresql.url(postgresql.create_database(template)),
        "blob_url": f"s3://{bucket_server.create_bucket()}",
        "s3_endpoint_url": bucket_server.url,
        "s3_access_key_id": "test",
        "s3_secret_access_key": "test",
    }


@pytest.fixture
def broker(shape: Shape, tmp_path: Path) -> Iterator[Broker]:
    """Give a running broker of the shape: on a unix socket, or on a port.

    The socket is in a folder of its own, because pytest's paths are longer than a socket's may be.
    """
    with tempfile.TemporaryDirectory(prefix="cs3d-") as short:
        broker = Broker(tmp_path / "broker", socket=Path(short) / "broker.sock" if shape == "embedded" else None)
        broker.start()
        yield broker
        broker.kill()


@pytest.fixture
def services(
    shape_settings: dict[str, Any], broker: Broker, tmp_path: Path, request: pytest.FixtureRequest
) -> Iterator[Services]:
    """Give services with quick leases; `@pytest.mark.parametrize("services", [{...}], indirect=True)` sets more."""
    more: dict[str, Any] = getattr(request, "param", {})
    place = {"broker_url": broker.url}
    services = Services.from_settings(
        Settings(data_dir=tmp_path / "data", **{**QUICK, **shape_settings, **place, **more})
    )
    yield services
    services.close()


@pytest.fixture
def installation(services: Services, broker: Broker, tmp_path: Path) -> Iterator[Installation]:
    """Give an installation with one team and one phase, and the means to start workers."""
    installation = Installation(services=services, broker=broker, folder=tmp_path)
    installation.populate()
    yield installation
    installation.close()
