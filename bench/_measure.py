"""One measurement of the evaluator in a process of its own, so that peak memory and imports are its own.

    python _measure.py WHAT GROUND_TRUTH_ARRAYS PREDICTIONS_ZIP RESULT_FILE

WHAT is `zipfile` or `isal` (a floor: inflate and typed JSON decode alone, by Python's own zip reader or by ours), or
`one` or `two` (processes of the evaluator; the second is started before, like the ground truth). Prints JSON: best and
median seconds of several runs, the best processor seconds (of the second process the mean; what a busy machine disturbs
least), and the peak memory of this process and its children in MB.
"""

import gc
import json
import resource
import statistics
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

from evaluator.archive import open_source
from evaluator.cityscapes_format import cityscapes_results
from evaluator.decoding import box_decoder
from evaluator.findings import Findings
from evaluator.ground_truth import GroundTruth
from evaluator.limits import DEFAULT_LIMITS
from evaluator.parallel import TwoProcesses, evaluate_file
from evaluator.protocol import CITYSCAPES3D, VEHICLE_LABELS
from evaluator.results import Scores

RUNS = 12


def zipfile_floor(source: Path) -> None:
    """Inflate every member with the standard library and decode it into typed records; keep nothing."""
    decode = box_decoder(VEHICLE_LABELS).decode
    gc.disable()
    with zipfile.ZipFile(source) as archive:
        for info in archive.infolist():
            decode(archive.read(info))
    gc.enable()


def isal_floor(source: Path) -> None:
    """Inflate every member as the evaluator does and decode it into typed records; keep nothing."""
    decode = box_decoder(VEHICLE_LABELS).decode
    gc.disable()
    with open_source(source, DEFAULT_LIMITS, Findings()) as files:
        if files is None:
            raise SystemExit("the workload is not a valid zip")
        for number in range(len(files.names)):
            decode(files.read(number))
    gc.enable()


def _own_peak_kb() -> int:
    """Return the peak memory of this program; getrusage would still count the process that started it."""
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))


def _processor_s() -> float:
    """Return the processor seconds of this process and those it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def main() -> None:
    """Measure what the command line names."""
    what, ground_truth_file, zip_file, result_file = sys.argv[1:]
    ground_truth = GroundTruth.from_bytes(Path(ground_truth_file).read_bytes())
    source = Path(zip_file)
    both = TwoProcesses(ground_truth, CITYSCAPES3D) if what == "two" else None

    def evaluated() -> Scores:
        one = evaluate_file(source, ground_truth, CITYSCAPES3D, split=False) if both is None else both.evaluate(source)
        if one.scores is None:
            raise SystemExit(f"the workload is refused: {one.report}")
        return one.scores

    floors: dict[str, Callable[[Path], None]] = {"zipfile": zipfile_floor, "isal": isal_floor}
    work: Callable[[], object] = (lambda: floors[what](source)) if what in floors else evaluated
    seconds, processor_seconds = [], []
    for _ in range(RUNS):
        start, processor_start = time.perf_counter(), _processor_s()
        work()
        seconds.append(time.perf_counter() - start)
        processor_seconds.append(_processor_s() - processor_start)
    if what not in floors:
        Path(result_file).write_text(json.dumps(cityscapes_results(evaluated())), encoding="utf-8")
    least_processor_s = min(processor_seconds)
    if both is not None:
        before = _processor_s()
        both.close()
        least_processor_s += (_processor_s() - before) / (RUNS + 1)  # the second process tells its own at its end only
    peak = max(_own_peak_kb(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
    result = {"best_s": min(seconds), "median_s": statistics.median(seconds), "processor_s": least_processor_s}
    print(json.dumps({**result, "peak_mb": peak / 1024}))


if __name__ == "__main__":
    main()
