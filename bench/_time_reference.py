"""Time the reference implementation. Run by evaluator_speed.py in the reference's own environment, never imported.

    python _time_reference.py GT_FOLDER PREDICTION_FOLDER RESULT_FILE

Prints the seconds and processor seconds from prediction files to results; reading the ground truth and importing are
not counted.
"""

import json
import logging
import sys
import time
from importlib import import_module
from pathlib import Path

LABELS = ["car", "truck", "bus", "train", "motorcycle", "bicycle"]


def main() -> None:
    """Evaluate once with all defaults."""
    gt_folder, prediction_folder, result_file = sys.argv[1:]
    reference = import_module("cityscapesscripts.evaluation.evalObjectDetection3d")  # opens eval.log where it is run
    logging.disable(logging.CRITICAL)
    evaluator = reference.Box3dEvaluator(reference.EvaluationParameters(LABELS))
    evaluator.checkCw()
    evaluator.loadGT(gt_folder)
    start, processor_start = time.perf_counter(), time.process_time()
    evaluator.loadPredictions(prediction_folder)
    evaluator.evaluate()
    print(time.perf_counter() - start, time.process_time() - processor_start)
    Path(result_file).write_text(json.dumps(evaluator.results), encoding="utf-8")


if __name__ == "__main__":
    main()
