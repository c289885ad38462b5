"""The blob store: immutable bytes named by their SHA-256, in a folder or an S3-compatible bucket.

Bytes are written under a temporary name, flushed to the disk and only then promoted to their digest, so a digest
never names half a file. Rows refer to blobs by digest; `record_blob` is the only way a digest gets into the database.
"""

import errno
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Protocol, cast

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from server import database
from server.errors import NotFound, StorageFull, Unavailable
from server.models import Blob, Shard
from server.settings import Settings

CHUNK_BYTES = 1024 * 1024
_NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK)
"""What file systems say that have none, or no more of one file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredBlob:
    """One blob as the store lists it."""

    sha256: str
    size_bytes: int
    modified_at: datetime
    """By the store's clock; putting the same bytes again renews it."""


class Blobs(Protocol):
    """What the record needs of a blob store. Raises `NotFound`, `StorageFull` or `Unavailable`."""

    incoming: Path
    """A local folder for bytes that are still arriving; from here promotion is cheapest."""

    @property
    def cache(self) -> Path | None:
        """A local folder of copies for reading; None: the store itself is local."""

    def put_file(self, path: Path, sha256: str) -> None:
        """Promote a complete local file under its digest; the file at `path` is gone afterwards."""

    def put_bytes(self, data: bytes) -> str:
        """Keep `data` and return its digest."""

    def read(self, sha256: str) -> bytes:
        """Return the whole blob."""

    def stream(self, sha256: str) -> Iterator[bytes]:
        """Yield the blob in chunks."""

    def local_path(self, sha256: str) -> Path:
        """Return a local, read-only file with the blob's bytes."""

    def exists(self, sha256: str) -> bool:
        """Say whether the store has the blob."""

    def delete(self, sha256: str) -> None:
        """Remove the blob; nothing happens when there is none."""

    def stored(self) -> Iterator[StoredBlob]:
        """List everything in the store."""


def open_blobs(settings: Settings) -> Blobs:
    """Open the store the settings name."""
    if not settings.blob_url:
        return FolderBlobs(settings.blob_folder)
    return BucketBlobs(settings)


def digest_file(path: Path) -> str:
    """Return the SHA-256 of a file in lower-case hex."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_durably(folder: Path, data: bytes) -> Path:
    """Write `data` to a new temporary file in `folder` and flush it to the disk."""
    path = folder / f"{uuid.uuid4().hex}.tmp"
    with no_room_is_said(), deleted_on_failure(path):
        folder.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
    return path


@contextmanager
def deleted_on_failure(path: Path) -> Iterator[None]:
    """Delete a file that could not be finished: half a file on a full disk would keep it full."""
    try:
        yield
    except BaseException:
        path.unlink(missing_ok=True)
        raise


@contextmanager
def no_room_is_said() -> Iterator[None]:
    """Turn "no space left on device" into `StorageFull`."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            message = "the server has no room left for files; try again later, the maintainers are needed"
            raise StorageFull(message) from error
        raise


def _flush(path: Path) -> None:
    """Flush a file or a folder's entries to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _promote(path: Path, target: Path) -> None:
    """Give a complete file the name of its digest; a file that has it already stays, as young as this one.

    It holds the same bytes, and a confined process that may read it (worker/confinement.py) could not read another one.
    """
    while True:
        try:
            target.hardlink_to(path)
        except FileExistsError:
            try:
                os.utime(target)
            except FileNotFoundError:  # deleted at this moment
                continue
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise
            path.replace(target)
            return
        path.unlink()
        return


class FolderBlobs:
    """Blobs as read-only files `<first two digits>/<digest>` in a folder."""

    def __init__(self, folder: Path) -> None:
        """Use `folder`, creating it when it is missing."""
        self.folder = folder
        self.cache: Path | None = None
        self.incoming = folder / "incoming"
        self.incoming.mkdir(parents=True, exist_ok=True)

    def _path(self, sha256: str) -> Path:
        return self.folder / sha256[:2] / sha256

    def put_file(self, path: Path, sha256: str) -> None:
        """Promote a complete local file; on the same file system that is one rename."""
        target = self._path(sha256)
        with no_room_is_said():
            if path.stat().st_dev != self.folder.stat().st_dev:
                path = self._bring_over(path)
            path.chmod(0o444)
            _flush(path)
            target.parent.mkdir(exist_ok=True)
            os.utime(path)
            _promote(path, target)
            _flush(target.parent)

    def _bring_over(self, path: Path) -> Path:
        """Copy a file from another file system beside the blobs, so that promotion stays one rename."""
        copy = self.incoming / f"{uuid.uuid4().hex}.tmp"
        with deleted_on_failure(copy):
            shutil.copyfile(path, copy)
        path.unlink()
        return copy

    def put_bytes(self, data: bytes) -> str:
        """Keep `data` and return its digest."""
        sha256 = hashlib.sha256(data).hexdigest()
        self.put_file(write_durably(self.incoming, data), sha256)
        return sha256

    def read(self, sha256: str) -> bytes:
        """Return the whole blob."""
        return self.local_path(sha256).read_bytes()

    def stream(self, sha256: str) -> Iterator[bytes]:
        """Yield the blob in chunks of 1 MiB."""
        with self.local_path(sha256).open("rb") as stream:
            while chunk := stream.read(CHUNK_BYTES):
                yield chunk

    def local_path(self, sha256: str) -> Path:
        """Return the blob's own file."""
        path = self._path(sha256)
        if not path.is_file():
            raise NotFound(_missing(sha256))
        return path

    def exists(self, sha256: str) -> bool:
        """Say whether the file is there."""
        return self._path(sha256).is_file()

    def delete(self, sha256: str) -> None:
        """Remove the file."""
        self._path(sha256).unlink(missing_ok=True)

    def stored(self) -> Iterator[StoredBlob]:
        """List every promoted file."""
        for path in self.folder.glob("[0-9a-f][0-9a-f]/*"):
            try:
                status = path.stat()
            except FileNotFoundError:
                continue  # deleted while we list
            modified_at = datetime.fromtimestamp(status.st_mtime, UTC)
            yield StoredBlob(sha256=path.name, size_bytes=status.st_size, modified_at=modified_at)


class BucketBlobs:
    """Blobs as objects `<prefix>/<digest>` in an S3-compatible bucket, with a local cache for reading."""

    def __init__(self, settings: Settings) -> None:
        """Open the bucket of `settings.blob_url`; nothing is asked of it yet."""
        self._store: Any = _open_bucket(settings)
        self.cache: Path = settings.data_dir.absolute() / "cache"
        self.incoming = settings.data_dir.absolute() / "incoming"
        self.cache.mkdir(parents=True, exist_ok=True)
        self.incoming.mkdir(parents=True, exist_ok=True)

    def put_file(self, path: Path, sha256: str) -> None:
        """Upload a file; the store shows an object only once it is whole."""
        with _bucket_errors(sha256):
            self._store.put(sha256, path)
        path.unlink()

    def put_bytes(self, data: bytes) -> str:
        """Upload `data` and return its digest."""
        sha256 = hashlib.sha256(data).hexdigest()
        with _bucket_errors(sha256):
            self._store.put(sha256, data)
        return sha256

    def read(self, sha256: str) -> bytes:
        """Download the whole object."""
        with _bucket_errors(sha256):
            return bytes(self._store.get(sha256).bytes())

    def stream(self, sha256: str) -> Iterator[bytes]:
        """Download the object in chunks."""
        with _bucket_errors(sha256):
            for chunk in self._store.get(sha256).stream(min_chunk_size=CHUNK_BYTES):
                yield bytes(chunk)

    def local_path(self, sha256: str) -> Path:
        """Return the cached copy, downloading and checking it first when there is none."""
        path = self.cache / sha256
        if not path.is_file():
            self._download(sha256, path)
        os.utime(path)
        return path

    def _download(self, sha256: str, path: Path) -> None:
        digest = hashlib.sha256()
        temporary = self.cache / f"{uuid.uuid4().hex}.tmp"
        try:
            with no_room_is_said(), temporary.open("xb") as stream:
                for chunk in self.stream(sha256):
                    digest.update(chunk)
                    stream.write(chunk)
            if digest.hexdigest() != sha256:
                message = f"blob {sha256} arrived with other bytes than its name says; check the blob store"
                raise Unavailable(message)
            temporary.chmod(0o444)
            _promote(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)

    def exists(self, sha256: str) -> bool:
        """Ask the store for the object's head."""
        try:
            with _bucket_errors(sha256):
                self._store.head(sha256)
        except NotFound:
            return False
        return True

    def delete(self, sha256: str) -> None:
        """Remove the object and its cached copy."""
        with _bucket_errors(sha256):
            self._store.delete(sha256)
        (self.cache / sha256).unlink(missing_ok=True)

    def stored(self) -> Iterator[StoredBlob]:
        """List every object."""
        with _bucket_errors("(listing)"):
            for entries in self._store.list():
                for entry in entries:
                    name = str(entry["path"]).rsplit("/", 1)[-1]
                    yield StoredBlob(sha256=name, size_bytes=entry["size"], modified_at=entry["last_modified"])


def _open_bucket(settings: Settings) -> object:
    from obstore.store import S3Store  # noqa: PLC0415 - only the scale-out shape loads it

    secret = settings.s3_secret_access_key
    given = {
        "endpoint": settings.s3_endpoint_url,
        "access_key_id": settings.s3_access_key_id,
        "secret_access_key": secret.get_secret_value() if secret else None,
        "region": settings.s3_region,
    }
    return S3Store.from_url(
        settings.blob_url,
        config=cast("Any", {name: value for name, value in given.items() if value is not None}),
        client_options={"allow_http": True, "timeout": "300s", "connect_timeout": "5s"},
        retry_config={"max_retries": 3, "retry_timeout": timedelta(seconds=20)},
    )


@contextmanager
def _bucket_errors(sha256: str) -> Iterator[None]:
    """Turn the store's errors into ours."""
    from obstore.exceptions import BaseError  # noqa: PLC0415 - only the scale-out shape loads it

    try:
        yield
    except FileNotFoundError as error:
        raise NotFound(_missing(sha256)) from error
    except BaseError as error:
        message = f"the blob store does not answer as it should ({type(error).__name__}); try again later"
        raise Unavailable(message) from error


def _missing(sha256: str) -> str:
    return f"the blob store has no {sha256}; restore it from a backup (`cs3d-admin check` lists what is missing)"


def record_blob(session: Session, blobs: Blobs, sha256: str, size_bytes: int) -> None:
    """Make `sha256` known to the record, once its bytes are in the store.

    A new row is checked against the store after it is inserted: server/file_sweeper.py holds the table's lock while
    it deletes, so a blob that was about to be swept is either seen as recorded or found missing here.

    Raises:
        Unavailable: The bytes are not in the store; the caller has to put them again.
    """
    insert = sqlite.insert if session.get_bind().dialect.name == "sqlite" else postgresql.insert
    row = {"sha256": sha256, "size_bytes": size_bytes, "created_at": database.now(session)}
    done = session.execute(insert(Blob).values(row).on_conflict_do_nothing())
    if cast("sa.CursorResult[Any]", done).rowcount and not blobs.exists(sha256):
        message = f"blob {sha256} is not in the store any more; send it again"
        raise Unavailable(message)


def known_digests(session: Session, among: Sequence[str] | None = None) -> set[str]:
    """Read the digests that rows keep: those of `Blob` and, while submissions are scored in shards, those of `Shard`.

    Args:
        session: Of the transaction.
        among: Only those of these; None: all.
    """
    columns = (Blob.sha256, Shard.predictions_sha256, Shard.result_sha256)
    chosen = (sa.select(one) if among is None else sa.select(one).where(one.in_(among)) for one in columns)
    return {sha256 for query in chosen for sha256 in session.scalars(query) if sha256}
