"""The web application on a real port, served by uvicorn from a thread of the test."""

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import uvicorn

from server import accounts, benchmarks, passwords
from server.api.spool import UploadLimits
from server.services import Services
from server.web import create_app
from tests.services.installation import SMALL_CASE
from tests.services.processes import free_port, wait_until

PASSWORD = "correct horse battery staple"
PASSWORD_HASH = passwords.hashed(PASSWORD)


@dataclass(frozen=True, kw_only=True)
class Site:
    """A running web application."""

    url: str
    services: Services

    def client(self, token: str | None = None) -> httpx.Client:
        """Open a client; without a token, nobody's."""
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        return httpx.Client(base_url=self.url, headers=headers, timeout=30)

    def token(self, *, email: str = "ann@example.org", team: str = "lab") -> str:
        """Make a token of a user for a team."""
        with self.services.transaction() as session:
            user, of = accounts.find_user(session, email), accounts.find_team(session, team)
            _, secret = accounts.create_token(
                session, user=user, team=of, name="test", expires_at=None, actor="admin:test"
            )
        return secret

    def stranger(self, *, email: str = "eve@example.org", team: str = "others", is_maintainer: bool = False) -> str:
        """Make a user in a team of their own, and a token."""
        with self.services.transaction() as session:
            user = accounts.create_user(
                session, email=email, name="Eve", password_hash=None, is_maintainer=is_maintainer, actor="admin:test"
            )
            accounts.create_team(session, slug=team, name=team.title(), members=[user], actor="admin:test")
        return self.token(email=email, team=team)


def populate(services: Services, **phase: Any) -> None:
    """Create Ann (with a password) in team `lab`, and the hidden phase `cs3d/test` with the small case."""
    with services.transaction() as session:
        ann = accounts.create_user(
            session,
            email="ann@example.org",
            name="Ann",
            password_hash=PASSWORD_HASH,
            is_maintainer=False,
            actor="admin:test",
        )
        accounts.create_team(session, slug="lab", name="Lab", members=[ann], actor="admin:test")
        benchmark = benchmarks.create_benchmark(session, slug="cs3d", title="Cityscapes 3D", actor="admin:test")
        made = benchmarks.create_phase(
            session,
            benchmark=benchmark,
            slug="test",
            title="Test",
            actor="admin:test",
            **{"submissions_per_day": 1000, **phase},
        )
        benchmarks.import_ground_truth(
            session, services.blobs, phase=made, source=SMALL_CASE / "gt", actor="admin:test"
        )


def send(client: httpx.Client, body: bytes, *, method: str = "ours", **headers: str) -> httpx.Response:
    """Send an archive as the raw body."""
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return client.post(
        "/api/v1/submissions",
        params={"benchmark": "cs3d", "phase": "test", "method": method},
        content=body,
        headers={"Content-Type": "application/zip", **named},
    )


@contextlib.contextmanager
def running_site(services: Services, *, limits: UploadLimits | None = None) -> Iterator[Site]:
    """Serve an application with `services` until the end of the block."""
    port = free_port()
    config = uvicorn.Config(create_app(services, limits=limits), port=port, log_level="warning", lifespan="on")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    wait_until(lambda: server.started, what="the web application")
    try:
        yield Site(url=f"http://127.0.0.1:{port}", services=services)
    finally:
        server.should_exit = True
        thread.join(timeout=20)
