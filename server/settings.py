"""Settings: one flat table, read from the environment (`CS3D_...`) or given in code.

The defaults are the embedded shape: everything lives in `data_dir`. The scale-out shape differs only in the URLs.
docs/operating explains every setting; a test holds that table and this file together.
"""

import hashlib
import os
import secrets
import tempfile
from pathlib import Path
from typing import Self

from pydantic import Field, SecretStr, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from evaluator.limits import DEFAULT_LIMITS

MIB = 1024 * 1024

LONGEST_SOCKET_PATH = 100
"""Bytes; the kernel takes 107 on Linux and 103 on macOS."""


class Settings(BaseSettings):
    """Everything an installation can choose. Times in seconds, sizes in bytes."""

    model_config = SettingsConfigDict(env_prefix="CS3D_", extra="ignore", frozen=True)

    data_dir: Path = Path("data")
    """Holds the database, the blobs, the broker's socket and the secret key, unless the URLs say otherwise."""
    database_url: str = ""
    """SQLAlchemy URL, `postgresql+psycopg://...`; empty: SQLite in `data_dir`."""
    broker_url: str = ""
    """Celery URL, `redis://...`; empty: the embedded broker's unix socket in `data_dir`."""
    blob_url: str = ""
    """`s3://bucket[/prefix]`; empty: the folder `blobs` in `data_dir`."""
    s3_endpoint_url: str | None = None
    """For S3-compatible stores other than AWS."""
    s3_access_key_id: str | None = None
    s3_secret_access_key: SecretStr | None = None
    s3_region: str = "us-east-1"

    public_url: str = "http://127.0.0.1:8000"
    """Where participants reach the server; used in links and mails."""
    secret_key: SecretStr = SecretStr("")
    """Signs login sessions; empty: generated once into `data_dir/secret_key`. Give the same to every web process."""
    upload_max_bytes: int = Field(default=DEFAULT_LIMITS.archive_bytes, ge=1)
    disk_floor_bytes: int = Field(default=512 * MIB, ge=0)
    """Uploads are refused with 507 when less would stay free."""

    lease_s: float = Field(default=60.0, gt=0)
    """A worker that is silent for so long has lost its submission."""
    heartbeat_s: float = Field(default=5.0, gt=0)
    """How often a worker renews its lease and writes the progress."""
    sweep_s: float = Field(default=15.0, gt=0)
    """How often lost submissions are looked for."""
    resend_s: float = Field(default=30.0, gt=0)
    """A waiting submission whose message is older gets a new one."""
    orphan_grace_s: float = Field(default=3600.0, ge=0)
    """Blobs and temporary files without a row are deleted after so long."""
    broker_timeout_s: float = Field(default=2.0, gt=0)
    """An upload waits at most about so long for a broker that hangs."""
    worker_concurrency: int = Field(default=0, ge=0)
    """Submissions scored at a time by one worker; 0: one per core."""
    score_memory_bytes: int = Field(default=4096 * MIB, ge=64 * MIB)
    """Address space of the process that reads and scores one submission."""
    score_time_s: float = Field(default=600.0, gt=0)
    """It is stopped after so long."""
    sandbox_required: bool = False
    """True: a worker refuses to start where the kernel leaves the scoring process the network or other files."""

    smtp_host: str = ""
    """Empty: no mail is sent."""
    smtp_port: int = Field(default=25, ge=1, le=65535)
    smtp_user: str = ""
    smtp_password: SecretStr = SecretStr("")
    smtp_starttls: bool = False
    smtp_timeout_s: float = Field(default=10.0, gt=0)
    mail_from: str = "cityscapes3d@localhost"
    maintainers_email: str = ""
    """Is told about failed submissions; empty: nobody is."""

    @model_validator(mode="after")
    def _heartbeat_within_lease(self) -> Self:
        """Refuse a heartbeat that could not keep a lease alive."""
        if self.heartbeat_s * 2 > self.lease_s:
            message = f"heartbeat_s ({self.heartbeat_s}) must be at most half of lease_s ({self.lease_s})"
            raise ValueError(message)
        return self

    @property
    def database(self) -> str:
        """The database's URL with the default filled in."""
        return self.database_url or f"sqlite:///{self.data_dir.absolute() / 'cs3d.sqlite'}"

    @property
    def broker(self) -> str:
        """The broker's URL with the default filled in."""
        return self.broker_url or f"redis+socket://{self.broker_socket}"

    @property
    def broker_socket(self) -> Path:
        """Where the embedded broker listens: in the data folder, or for a long path in a short one named after it."""
        path = self.data_dir.absolute() / "broker.sock"
        if len(os.fsencode(path)) <= LONGEST_SOCKET_PATH:
            return path
        digest = hashlib.sha256(os.fsencode(path)).hexdigest()
        return Path(tempfile.gettempdir()) / f"cs3d-{os.getuid()}-{digest[:16]}" / "broker.sock"

    @property
    def embedded_broker(self) -> bool:
        """True when no broker is named, so the server runs its own."""
        return not self.broker_url

    @property
    def blob_folder(self) -> Path:
        """The folder of the blobs in the embedded shape."""
        return self.data_dir.absolute() / "blobs"

    def signing_key(self) -> str:
        """Return the key that signs login sessions, generating it on first use.

        Two processes starting at once agree: the first to create the file wins, the other reads it.
        """
        if given := self.secret_key.get_secret_value():
            return given
        self.data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
        path = self.data_dir / "secret_key"
        if not path.exists():
            _create_private(path, secrets.token_urlsafe(48))
        return path.read_text(encoding="ascii")

    def environment(self) -> dict[str, str]:
        """Give these settings as environment variables for a process of ours (a worker, a web process)."""
        values = self.model_dump(exclude_defaults=True)
        return {f"CS3D_{name.upper()}": _as_text(value) for name, value in values.items() if value is not None}


def _as_text(value: object) -> str:
    return value.get_secret_value() if isinstance(value, SecretStr) else str(value)


def _create_private(path: Path, text: str) -> None:
    """Create a file that only its owner reads, complete from the first moment it is seen; the first writer wins."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as stream:
        stream.write(text)
    try:
        os.link(temporary, path)
    except FileExistsError:
        pass
    finally:
        temporary.unlink()
