"""Upload of 1 GiB, from its first byte to the answer 202, beside `dd` with fsync of as many bytes on the same disk.

    python bench/service_upload.py [--mib 1024] [--rounds 3]

The archive is a valid zip of stored members that cannot be compressed; it is sent as a raw body over loopback. The
answer 202 comes after the bytes are hashed, checked as a zip, flushed to the disk and promoted to a blob. `dd` copies
the same archive. The two take turns, each on a disk with nothing left to write; printed are all times, and the ratio of
the best ones. Memory of the server is sampled during the uploads and compared with what it was after a small one: its
own, and all that is resident, which the target is about.
"""

import argparse
import os
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Self

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import httpx  # noqa: E402 - the path is set above

from bench._installation import Memory, Site, WebServer, machine, running_site  # noqa: E402 - likewise

MIB = 1 << 20
SPEED_TARGET, GROWTH_TARGET_MIB = 0.4, 32
SAMPLE_S = 0.02


def main() -> int:
    """Measure; status 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mib", type=int, default=1024)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    print(f"{args.mib} MiB, {machine()}")
    with running_site(application="bench._roomy_web:application", upload_max_bytes=2 * args.mib * MIB) as site:
        folder = site.installation.folder
        small, archive = folder / "small.zip", folder / "large.zip"
        _write_archive(small, 16)
        _write_archive(archive, args.mib)
        _upload(site, small)
        with _Memory(site.web) as memory:
            turns = [(_copy(archive, folder / "copy"), _upload(site, archive)) for _ in range(args.rounds)]
    return _show(turns, memory.growth_mib, args.mib)


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


def _upload(site: Site, archive: Path) -> float:
    """Time one upload; its blob is deleted, so that the next one finds as much room."""
    headers = {
        "Authorization": site.authorization,
        "Content-Type": "application/zip",
        "Content-Length": str(archive.stat().st_size),
    }
    order = {"benchmark": "cs3d", "phase": "test", "method": "large"}
    url = f"{site.url}/api/v1/submissions"
    os.sync()
    started_s = time.perf_counter()
    response = httpx.post(url, params=order, content=_blocks(archive), headers=headers, timeout=300)
    elapsed_s = time.perf_counter() - started_s
    if response.status_code != httpx.codes.ACCEPTED:
        raise SystemExit(f"the upload was answered {response.status_code}: {response.text[:500]}")
    site.installation.services.blobs.delete(response.json()["predictions"]["sha256"])
    return elapsed_s


def _blocks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as stream:
        while block := stream.read(MIB):
            yield block


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


def _show(turns: list[tuple[float, float]], growth_mib: tuple[float, float], mib: int) -> int:
    for name, times_s in zip(("dd conv=fsync", "upload to 202"), zip(*turns, strict=True), strict=True):
        shown = ", ".join(f"{time_s:.2f}" for time_s in times_s)
        print(f"  {name:16} {mib / min(times_s):6.0f} MiB/s at best  ({shown} s)")
    ratio = min(dd_s for dd_s, _ in turns) / min(upload_s for _, upload_s in turns)
    met = ratio >= SPEED_TARGET, growth_mib[1] <= GROWTH_TARGET_MIB
    said = ["met" if one else "MISSED" for one in met]
    print(f"  {ratio:.2f} of dd, target {SPEED_TARGET}: {said[0]}")
    print(f"  resident memory grew by {growth_mib[1]:.1f} MiB at most, target {GROWTH_TARGET_MIB}: {said[1]}")
    print(f"  of it the server's own: {growth_mib[0]:.1f} MiB")
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
