"""The demo's benchmark: imaginary ground truth in real files, teams, a user, and the zips of three methods."""

import json
import os
import secrets
from dataclasses import dataclass
from pathlib import Path

import msgspec
from sqlalchemy.orm import Session

from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions, write_zip
from server import accounts, benchmarks, passwords
from server.admin.command import actor
from server.errors import Conflict, NotFound
from server.services import Services

BENCHMARK = "cityscapes3d"
EMAIL = "demo@example.org"


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoPhase:
    """One phase of the demo."""

    slug: str
    title: str
    is_open: bool
    images: int
    seed: int


PHASES = (
    DemoPhase(slug="val", title="Validation (open)", is_open=True, images=60, seed=11),
    DemoPhase(slug="test", title="Test (hidden)", is_open=False, images=500, seed=12),
)

TEAMS = {
    "orthoview-9dof": ("aurora", "Aurora Vision Lab"),
    "mono-lift": ("borealis", "Borealis Perception"),
    "prior-baseline": ("campus", "Campus Vision Group"),
}
"""Method -> slug and name of the team that sends it."""


class Logins(msgspec.Struct, frozen=True, kw_only=True):
    """What is needed to use the demo again; kept in a file that only its owner reads."""

    email: str
    password: str
    tokens: dict[str, str]
    """Team -> API token."""


def prepare(services: Services) -> Logins:
    """Make the benchmark unless it is there.

    Raises:
        Conflict: The data folder holds an installation that is not a demo.
    """
    kept = services.settings.data_dir / "demo.json"
    with services.transaction() as session:
        if _is_there(session):
            if not kept.exists():
                message = f"{services.settings.data_dir} holds a real installation; give the demo another --data-dir"
                raise Conflict(message)
            return msgspec.json.decode(kept.read_bytes(), type=Logins)
        logins = _create_people(session)
        _create_benchmark(session, services)
        # Before the commit: the benchmark is never there without the file.
        _write_private(kept, json.dumps(msgspec.to_builtins(logins), indent=2))
    return logins


def archive(services: Services, phase: DemoPhase, method: str) -> Path:
    """Name the zip with a method's predictions for a phase, making it when it is missing."""
    folder = _folder(services, phase)
    path = folder / f"{method}.zip"
    if not path.exists():
        quality = next(quality for quality in QUALITIES if quality.name == method)
        ground_truth = synthesize_ground_truth(phase.images, phase.seed)
        write_zip(synthesize_predictions(ground_truth, quality, phase.seed), path)
    return path


def _folder(services: Services, phase: DemoPhase) -> Path:
    """Name the folder with a phase's files, which visitors of the demo may upload themselves."""
    return services.settings.data_dir / "synthetic" / phase.slug


def _is_there(session: Session) -> bool:
    """Tell whether the benchmark exists."""
    try:
        benchmarks.find_benchmark(session, BENCHMARK)
    except NotFound:
        return False
    return True


def _create_people(session: Session) -> Logins:
    """Create a user, who is in every team, and a token for each team."""
    password = secrets.token_urlsafe(9)
    user = accounts.create_user(
        session,
        email=EMAIL,
        name="Demo User",
        password_hash=passwords.hashed(password),
        is_maintainer=True,
        actor=actor(),
    )
    tokens = {}
    for slug, name in TEAMS.values():
        team = accounts.create_team(session, slug=slug, name=name, members=[user], actor=actor())
        _, tokens[slug] = accounts.create_token(
            session, user=user, team=team, name="demo", expires_at=None, actor=actor()
        )
    return Logins(email=EMAIL, password=password, tokens=tokens)


def _create_benchmark(session: Session, services: Services) -> None:
    """Create the benchmark with its phases and their ground truth."""
    benchmark = benchmarks.create_benchmark(
        session,
        slug=BENCHMARK,
        title="Cityscapes 3D (demo)",
        description="Imaginary images with the data set's statistics.",
        actor=actor(),
    )
    for phase in PHASES:
        created = benchmarks.create_phase(
            session,
            benchmark=benchmark,
            slug=phase.slug,
            title=phase.title,
            is_open=phase.is_open,
            submissions_per_day=100,
            actor=actor(),
        )
        source = _write_ground_truth(_folder(services, phase) / "gt", phase)
        benchmarks.import_ground_truth(session, services.blobs, phase=created, source=source, actor=actor())


def _write_ground_truth(folder: Path, phase: DemoPhase) -> Path:
    """Write a phase's annotation files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in synthesize_ground_truth(phase.images, phase.seed).items():
        (folder / name).write_bytes(content)
    return folder


def _write_private(path: Path, text: str) -> None:
    """Write a file that only its owner reads."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as stream:
        stream.write(text)
