"""Upload of 1 GiB, from its first byte to the answer 202, beside `dd` with fsync of as many bytes on the same disk.

    python bench/service_upload.py [--mib 1024] [--rounds 3]

The archive is a valid zip of stored members that cannot be compressed; it is sent over loopback in each way there is: as
a raw body, as the file of a form, and in resumable parts of 64 MiB. The answer 202 comes after the bytes are hashed,
checked as a zip, flushed to the disk and promoted to a blob. `dd` copies the same archive. The two take turns, each on a
disk with nothing left to write; printed are all times, and the ratio of the best ones, whose target is for the raw body.
Memory of the server is sampled during the uploads and compared with what it was after a small one: its own, and all that
is resident, which the target of every way is about.
"""

import argparse
import os
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import httpx  # noqa: E402 - the path is set above

from bench._installation import Memory, Site, WebServer, machine, running_site  # noqa: E402 - likewise

MIB = 1 << 20
SPEED_TARGET, GROWTH_TARGET_MIB = 0.4, 32
SAMPLE_S = 0.02
PART_BYTES = 64 * MIB
ORDER = {"benchmark": "cs3d", "phase": "test", "method": "large"}

Send = Callable[[httpx.Client, Path], httpx.Response]


def main() -> int:
    """Measure; status 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mib", type=int, default=1024)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    print(f"{args.mib} MiB, {machine()}")
    with running_site(upload_max_bytes=2 * args.mib * MIB) as site:
        folder = site.installation.folder
        small, archive = folder / "small.zip", folder / "large.zip"
        _write_archive(small, 16)
        _write_archive(archive, args.mib)
        met = []
        for way, send in WAYS.items():
            _upload(site, small, send)
            with _Memory(site.web) as memory:
                turns = [(_copy(archive, folder / "copy"), _upload(site, archive, send)) for _ in range(args.rounds)]
            met.append(_show(way, turns, memory.growth_mib, args.mib))
    return 0 if all(met) else 1


def _write_archive(path: Path, mib: int) -> None:
    """Write a zip of random bytes, one MiB a member."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for number in range(mib):
            archive.writestr(f"bench_{number:06}_000000_predBbox3d.json", os.urandom(MIB))


def _copy(source: Path, target: Path) -> float:
    """Time dd."""
    os.sync()
    started_s = time.perf_counter()
    command = ["dd", f"if={source}", f"of={target}", "bs=1M", "conv=fsync"]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
    elapsed_s = time.perf_counter() - started_s
    target.unlink()
    return elapsed_s


def _upload(site: Site, archive: Path, send: Send) -> float:
    """Time one upload; its blob is deleted, so that the next one finds as much room."""
    headers = {"Authorization": site.authorization}
    with httpx.Client(base_url=f"{site.url}/api/v1", headers=headers, timeout=300) as client:
        os.sync()
        started_s = time.perf_counter()
        response = send(client, archive)
        elapsed_s = time.perf_counter() - started_s
    if response.status_code != httpx.codes.ACCEPTED:
        raise SystemExit(f"the upload was answered {response.status_code}: {response.text[:500]}")
    site.installation.services.blobs.delete(response.json()["predictions"]["sha256"])
    return elapsed_s


def _send_raw(client: httpx.Client, archive: Path) -> httpx.Response:
    size = archive.stat().st_size
    headers = {"Content-Type": "application/zip", "Content-Length": str(size)}
    return client.post("/submissions", params=ORDER, content=_blocks(archive, 0, size), headers=headers)


def _send_form(client: httpx.Client, archive: Path) -> httpx.Response:
    with archive.open("rb") as stream:
        return client.post("/submissions", data=ORDER, files={"predictions": (archive.name, stream)})


def _send_parts(client: httpx.Client, archive: Path) -> httpx.Response:
    size = archive.stat().st_size
    response = client.post("/uploads", params=ORDER, headers={"Upload-Length": str(size)})
    address = f"{client.base_url.copy_with(path=response.headers['Location'])}"
    for offset in range(0, size, PART_BYTES):
        length = min(PART_BYTES, size - offset)
        headers = {
            "Content-Type": "application/partial-upload",
            "Content-Length": str(length),
            "Upload-Offset": str(offset),
        }
        response = client.patch(address, content=_blocks(archive, offset, length), headers=headers)
    return response


WAYS: dict[str, Send] = {"raw body": _send_raw, "form": _send_form, "parts of 64 MiB": _send_parts}


def _blocks(path: Path, offset: int, length: int) -> Iterator[bytes]:
    with path.open("rb") as stream:
        stream.seek(offset)
        for start in range(0, length, MIB):
            yield stream.read(min(MIB, length - start))


class _Memory(threading.Thread):
    """Samples the memory of the server while it is entered."""

    def __init__(self, web: WebServer) -> None:
        super().__init__(daemon=True)
        self._web = web
        self._ended = threading.Event()
        self._before = self._peak = web.memory()

    @property
    def growth_mib(self) -> tuple[float, float]:
        """Highest samples beyond the first: of the server's own memory, and of all that is resident."""
        before, peak = self._before, self._peak
        return (peak.own_bytes - before.own_bytes) / MIB, (peak.resident_bytes - before.resident_bytes) / MIB

    def run(self) -> None:
        while not self._ended.wait(SAMPLE_S):
            now = self._web.memory()
            self._peak = Memory(
                own_bytes=max(self._peak.own_bytes, now.own_bytes),
                resident_bytes=max(self._peak.resident_bytes, now.resident_bytes),
            )

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self.join()


def _show(way: str, turns: list[tuple[float, float]], growth_mib: tuple[float, float], mib: int) -> bool:
    """Print what was measured of one way of sending and say whether its targets are met."""
    print(f"{way}:")
    for name, times_s in zip(("dd conv=fsync", "upload to 202"), zip(*turns, strict=True), strict=True):
        shown = ", ".join(f"{time_s:.2f}" for time_s in times_s)
        print(f"  {name:16} {mib / min(times_s):6.0f} MiB/s at best  ({shown} s)")
    ratio = min(dd_s for dd_s, _ in turns) / min(upload_s for _, upload_s in turns)
    met = way != "raw body" or ratio >= SPEED_TARGET, growth_mib[1] <= GROWTH_TARGET_MIB
    said = ["met" if one else "MISSED" for one in met]
    print(f"  {ratio:.2f} of dd" + (f", target {SPEED_TARGET}: {said[0]}" if way == "raw body" else ""))
    print(f"  resident memory grew by {growth_mib[1]:.1f} MiB at most, target {GROWTH_TARGET_MIB}: {said[1]}")
    print(f"  of it the server's own: {growth_mib[0]:.1f} MiB")
    return all(met)


if __name__ == "__main__":
    sys.exit(main())
