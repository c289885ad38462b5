"""Writes the corpus of archives and prediction files: `python -m tests.data.make_corpus`.

A case is named `<case>.<codes>.<suffix>`, the codes being exactly those its report must have, joined by "+"; a case
about which nothing is to be said is named `<case>.<suffix>`.
"""

import shutil
from collections.abc import Iterable
from pathlib import Path

from tests.data import corpus_archives, corpus_archives_refused, corpus_predictions

DATA = Path(__file__).parent
Case = tuple[str, str, bytes]


def file_name(case: str, codes: str, suffix: str) -> str:
    """Name the file of a case."""
    return f"{case}.{codes}.{suffix}" if codes else f"{case}.{suffix}"


def expected_codes(path: Path) -> tuple[str, ...]:
    """Read the codes off a case's name."""
    parts = path.name.split(".")
    return tuple(parts[1].split("+")) if len(parts) > 2 else ()


def _write(cases: Iterable[Case], folder: Path, suffix: str) -> int:
    """Write all cases of one kind into an emptied folder and count them."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    count = 0
    for case, codes, data in cases:
        path = folder / file_name(case, codes, suffix)
        if path.exists():
            raise ValueError(f"two cases are called {case}")
        path.write_bytes(data)
        count += 1
    return count


def make_corpus(root: Path) -> int:
    """Write the whole corpus below `root` and count its cases."""
    return sum(
        (
            _write(corpus_archives.accepted(), root / "archives" / "accept", "zip"),
            _write(corpus_archives_refused.refused(), root / "archives" / "reject", "zip"),
            _write(corpus_predictions.accepted(), root / "predictions" / "accept", "json"),
            _write(corpus_predictions.refused(), root / "predictions" / "reject", "json"),
        )
    )


if __name__ == "__main__":
    make_corpus(DATA)
