import html
import importlib
import pkgutil
import re
from pathlib import Path
from types import ModuleType

import pytest

import client
import evaluator
import server
import server.api.errors
import server.errors
from evaluator import errors
from evaluator.codes import MEANINGS, Code
from evaluator.errors import BenchmarkError
from evaluator.intake import read_predictions
from evaluator.limits import DEFAULT_LIMITS, MIB
from server.errors import ServerError
from tests.data.corpus_predictions import IMAGE

DOCS = Path(__file__).parents[3] / "docs"


def test_every_code_is_documented_and_no_other() -> None:
    """docs/errors.md lists each code under its severity with the title and fix of the enum."""
    text = html.unescape((DOCS / "errors.md").read_text(encoding="utf-8"))
    found = {}
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        severity = section.split("\n", 1)[0].lower().removesuffix("s")
        for code, title, fix in re.findall(r"^\| `(\w+)` \| (.*) \| (.*) \|$", section, flags=re.MULTILINE):
            found[code] = (severity, title, fix)
    assert found == {code.value: (MEANINGS[code].severity, MEANINGS[code].title, MEANINGS[code].fix) for code in Code}


def _classes() -> list[type[BenchmarkError]]:
    """List the tree of errors but for what the server answers, which docs/api.md lists."""
    for package in (evaluator, client, server):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            importlib.import_module(module.name)
    found, waiting = [], list(BenchmarkError.__subclasses__())
    while waiting:
        kind = waiting.pop(0)
        if kind is not ServerError:
            found.append(kind)
            waiting.extend(kind.__subclasses__())
    return found


def test_the_tree_of_errors_is_the_one_drawn() -> None:
    """The drawing in evaluator/errors.py and the table in docs/errors.md hold each class with its code, and no other."""
    drawn = re.findall(r"^ {4}[│├└─ ]* ?(\w+) +(\w+) {2,}", errors.__doc__ or "", flags=re.MULTILINE)
    known = [(kind.__name__, kind.code) for kind in _classes()]
    ends = [("BenchmarkError", BenchmarkError.code), ("ServerError", ServerError.code)]
    assert sorted(drawn) == sorted([*known, *ends])
    text = (DOCS / "errors.md").read_text(encoding="utf-8").partition("## What ends a command")[2]
    listed = re.findall(r"^\| `(\w+)` \| (.*) \|$", text, flags=re.MULTILINE)
    assert sorted(listed) == sorted((kind.code, (kind.__doc__ or "").split("\n", 1)[0]) for kind in _classes())


@pytest.mark.parametrize("module", [server.errors, server.api.errors], ids=lambda module: module.__name__)
def test_what_the_server_answers_is_drawn(module: ModuleType) -> None:
    """The drawing in each module of errors holds its classes and what they come from, with parent, status and code."""
    drawn, path = set(), [BenchmarkError.__name__]
    for edge, name, status, code in re.findall(
        r"^ {4}([│├└─ ]*)(\w+) +(\d+) {2}(\w+)", module.__doc__ or "", flags=re.MULTILINE
    ):
        path = [*path[: len(edge) // 4 + 1], name]
        drawn.add((*path[-2:], int(status), code))
    found: set[type[BenchmarkError]] = set()
    waiting: list[type[BenchmarkError]] = [ServerError]
    while waiting:
        kind = waiting.pop()
        waiting.extend(kind.__subclasses__())
        if kind.__module__ == module.__name__:
            found |= {one for one in kind.__mro__ if issubclass(one, ServerError)}
    assert drawn == {(one.__bases__[0].__name__, one.__name__, one.status, one.code) for one in found}


def test_limits_are_documented() -> None:
    """docs/submission_format.md states the default limits."""
    text = (DOCS / "submission_format.md").read_text(encoding="utf-8")
    for row in (
        f"| archive | {DEFAULT_LIMITS.archive_bytes // MIB} MiB |",
        f"| all files unpacked | {DEFAULT_LIMITS.expanded_bytes // MIB // 1024} GiB |",
        f"| one file unpacked | {DEFAULT_LIMITS.file_bytes // MIB} MiB |",
        f"| unpacked size over packed size, above {DEFAULT_LIMITS.ratio_floor_bytes // MIB} MiB | {DEFAULT_LIMITS.ratio} |",
        f"| members | {DEFAULT_LIMITS.entries:,} |",
        f"| boxes in one image | {DEFAULT_LIMITS.boxes_per_image:,} |",
        f"| nesting of JSON | {DEFAULT_LIMITS.json_depth} levels |",
        f"| files with problems that are explained place by place, together | {DEFAULT_LIMITS.explained_bytes // MIB} MiB |",
    ):
        assert row in text


def test_example_of_the_docs_is_valid(tmp_path: Path) -> None:
    """The file shown in docs/submission_format.md passes."""
    text = (DOCS / "submission_format.md").read_text(encoding="utf-8")
    example = text.split("```json\n")[1].split("```")[0]
    (tmp_path / f"{IMAGE}_pred.json").write_text(example, encoding="utf-8")
    assert read_predictions(tmp_path, images=None).report.groups == ()
