"""One coverage-guided fuzzer in a process of its own: `python -m tests.fuzz.atheris_target archive|document [libFuzzer options]`."""

import importlib
import sys


def main() -> None:
    """Fuzz until told otherwise; libFuzzer ends the process."""
    name = sys.argv.pop(1)
    atheris = importlib.import_module("atheris")
    with atheris.instrument_imports(include=["evaluator", "json", "zipfile"]):
        agreement = importlib.import_module("tests.fuzz.agreement")
    atheris.Setup(sys.argv, {"archive": agreement.check_archive, "document": agreement.check_document}[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
