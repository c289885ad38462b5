"""Run the reference implementation on many cases. Started in the reference's own environment, never imported.

Importing the reference opens `eval.log` in the working directory and puts handlers on the root logger, so it gets a
process and a folder of its own. One process does all cases, because the import is slower than a case.

    python run_reference.py CASES.json RESULTS.json

CASES.json is a list of {"gt": folder, "pred": folder, "parameters": {...}}; RESULTS.json receives the list of results.
"""

import json
import logging
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

PARAMETERS = {
    "labels": "labels_to_evaluate",
    "min_iou": "min_iou_to_match",
    "max_depth": "max_depth",
    "step_size": "step_size",
    "modal": "matching_method",
    "cw": "cw",
    "num_conf": "num_conf",
}
"""Our name of each parameter -> the reference's."""


def evaluate(case: dict[str, Any], results_folder: str) -> Any:
    """Return the reference's results.json for one case."""
    reference = import_module("cityscapesscripts.evaluation.evalObjectDetection3d")

    logging.disable(logging.CRITICAL)
    values = {PARAMETERS[name]: value for name, value in case["parameters"].items()}
    parameters = reference.EvaluationParameters(**{**values, "matching_method": int(values["matching_method"])})
    reference.evaluate3dObjectDetection(case["gt"], case["pred"], results_folder, parameters, plot=False)
    return json.loads((Path(results_folder) / "results.json").read_text(encoding="utf-8"))


def main() -> None:
    """Evaluate all cases of the file named on the command line."""
    cases, output = map(Path, sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder:
        results = [evaluate(case, folder) for case in json.loads(cases.read_text(encoding="utf-8"))]
    output.write_text(json.dumps(results), encoding="utf-8")


if __name__ == "__main__":
    main()
