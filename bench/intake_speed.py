"""How long the strict reading takes beside inflating and JSON decoding alone.

    python bench/intake_speed.py [--images=1525] [--boxes=30]

The workload is synthetic and seeded. Beside the whole reading (framing, names, inflating, checksums, decoding, every
check, arrays, the convention doctor, the digest) stand in the same run: inflating and decoding alone with the standard
library, and with the fastest there is (isal, and msgspec into typed records). Also measured: files with keys of their
own, the framing check alone, and hostile files of growing size, whose time must grow no faster.
"""

import argparse
import gc
import json
import statistics
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from isal import isal_zlib  # noqa: E402 - the path is set above

from evaluator.archive import check_framing  # noqa: E402 - likewise
from evaluator.decoding import box_decoder  # noqa: E402 - likewise
from evaluator.findings import Findings  # noqa: E402 - likewise
from evaluator.ground_truth import ImageList, read_ground_truth  # noqa: E402 - likewise
from evaluator.intake import check_archive, read_predictions  # noqa: E402 - likewise
from evaluator.limits import DEFAULT_LIMITS  # noqa: E402 - likewise
from evaluator.protocol import VEHICLE_LABELS  # noqa: E402 - likewise
from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions, write_zip  # noqa: E402 - likewise

RUNS = 7
GROUND_TRUTH_SEED, PREDICTION_SEED = 1, 2


def main() -> int:
    """Measure and print; status 1 when the reading takes twice the time of inflating and decoding or more."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=1525)
    parser.add_argument("--boxes", type=float, default=30)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        images, files = _workload(folder, args.images, args.boxes)
        print(
            f"{args.images} images, {args.boxes:g} boxes each, {sum(map(len, files.values())) / 1e6:.1f} MB of JSON\n"
        )
        ratio = _compare(folder, images)
        _hostile(folder)
    print(f"\nreading / fastest inflating and decoding: {ratio:.2f} (to stay below 2)")
    return 0 if ratio < 2 else 1  # noqa: PLR2004 - the goal


def _workload(folder: Path, images: int, boxes: float) -> tuple[ImageList, dict[str, bytes]]:
    """Write `plain.zip` and, with keys of the uploader's own, `extra.zip`."""
    ground_truth = synthesize_ground_truth(images, GROUND_TRUTH_SEED)
    files = synthesize_predictions(ground_truth, QUALITIES[0], PREDICTION_SEED, boxes)
    write_zip(files, folder / "plain.zip")
    extra = {file: data.replace(b'"score"', b'"instanceId": 26001, "score"') for file, data in files.items()}
    write_zip(extra, folder / "extra.zip")
    write_zip(ground_truth, folder / "ground_truth.zip")
    return read_ground_truth(folder / "ground_truth.zip").image_list(), files


def _compare(folder: Path, images: ImageList) -> float:
    """Time the readings in turns, in processor time, so that all see the same machine; returns reading over the fastest floor."""
    plain, extra = folder / "plain.zip", folder / "extra.zip"
    work: dict[str, Callable[[], object]] = {
        "inflate and decode: zipfile and json": lambda: _with_standard_library(plain),
        "inflate and decode: isal and typed msgspec": lambda: _with_the_fastest(plain),
        "whole strict reading": lambda: read_predictions(plain, images=images),
        "whole strict reading, with keys of its own": lambda: read_predictions(extra, images=images),
        "framing check alone": lambda: check_archive(plain),
    }
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(RUNS):
        for name, call in work.items():
            start = time.process_time()
            call()
            seconds[name].append(time.process_time() - start)
    for name, values in seconds.items():
        print(f"{name:45} best {min(values) * 1e3:7.1f} ms, median {statistics.median(values) * 1e3:7.1f} ms")
    return min(seconds["whole strict reading"]) / min(seconds["inflate and decode: isal and typed msgspec"])


def _with_standard_library(source: Path) -> None:
    """Inflate and decode every member as most programs do."""
    with zipfile.ZipFile(source) as archive:
        for info in archive.infolist():
            json.loads(archive.read(info))


def _with_the_fastest(source: Path) -> None:
    """Inflate and decode every member, neither checking anything nor keeping it."""
    data = source.read_bytes()
    members = check_framing(data, DEFAULT_LIMITS, Findings())
    decode = box_decoder(VEHICLE_LABELS).decode
    gc.disable()
    for member in members:
        packed = data[member.start : member.start + member.packed_bytes]
        decode(isal_zlib.decompress(packed, -15, member.expanded_bytes))
    gc.enable()


def _hostile(folder: Path) -> None:
    """Time the slow path on single files of 1, 4 and 16 MB, each bad in another way."""
    print("\nhostile files, seconds for 1, 4 and 16 MB:")
    shapes = {
        "open brackets": b"[",
        "quotes": b'"',
        "backslashes in a string": b"\\\\",
        "escaped quotes in a string": b'\\"',
        "empty boxes": b"{},",
        "repeated keys": b'"a":1,',
        "digits": b"1",
        "commas": b",",
        "NaN": b"NaN,",
    }
    for name, unit in shapes.items():
        times = [_time_hostile(folder, unit, megabytes) for megabytes in (1, 4, 16)]
        print(f"  {name:28} {'  '.join(f'{value:6.2f}' for value in times)}")


def _time_hostile(folder: Path, unit: bytes, megabytes: int) -> float:
    """Time one file that repeats a unit where values stand."""
    start, end = (b'{"a":1,', b'"objects":[]}') if unit.startswith(b'"a"') else (b'{"objects":[', b"]}")
    start += b'"' if unit.startswith(b"\\") else b""
    text = start + unit * ((megabytes * 1_000_000 - len(start) - len(end)) // len(unit)) + end
    path = folder / "hostile" / "berlin_000000_000019_pred.json"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(text)
    begin = time.process_time()
    read_predictions(path.parent, images=None)
    return time.process_time() - begin


if __name__ == "__main__":
    sys.exit(main())
