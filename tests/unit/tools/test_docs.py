"""What the documentation says is so."""

import argparse
import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from pydantic import SecretStr

import do
import evaluator
from bench.protocol_differences import VARIANTS
from server.admin.main import build_parser
from server.settings import Settings

ROOT = Path(__file__).resolve().parents[3]
README = (ROOT / "README.md").read_text()
OPERATING = (ROOT / "docs" / "operating.md").read_text()
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text()
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")] + sorted(
    (ROOT / "docs").rglob("*.md")
)


def test_every_setting_is_documented_with_its_default() -> None:
    """The table of settings has a row for each, in the same order, with the default that the code has."""
    documented = dict(re.findall(r"^\| `(CS3D_\w+)` \| `(.*?)` \|", OPERATING, re.MULTILINE))
    defaults = {}
    for name, field in Settings.model_fields.items():
        default = field.default
        defaults[f"CS3D_{name.upper()}"] = (
            default.get_secret_value() if isinstance(default, SecretStr) else str(default)
        )
    assert documented == defaults
    assert list(documented) == list(defaults)


def test_every_command_of_the_administration_is_documented() -> None:
    """The table of commands names what `cs3d-admin --help` lists, and nothing else."""
    (action,) = (part for part in build_parser()._actions if isinstance(part, argparse._SubParsersAction))
    table = OPERATING.split("| command | does |")[1].split("\n\n")[0]
    documented = re.findall(r"`([a-z-]+)`", "".join(re.findall(r"^\| (.*?) \|", table, re.MULTILINE)))
    assert set(documented) == set(action.choices)


def test_the_map_shows_every_package() -> None:
    """Every folder with Python of ours stands in the map, and every folder in the map exists."""
    packages = {
        f"{path.parent.relative_to(ROOT)}/"
        for top in ("evaluator", "server", "worker", "client")
        for path in (ROOT / top).rglob("__init__.py")
    }
    mapped = set(re.findall(r"^\| `([a-z_/]+/)` \|", ARCHITECTURE, re.MULTILINE))
    assert packages <= mapped
    assert all((ROOT / folder).is_dir() for folder in mapped)


def test_files_named_in_the_map_exist() -> None:
    """A path with a folder and a suffix, wherever the architecture names one, is a file."""
    named = re.findall(r"`((?:evaluator|server|worker|client|migrations)/[a-z_/]+\.py)`", ARCHITECTURE)
    assert named
    assert [name for name in named if not (ROOT / name).is_file()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_within_the_tree_lead_somewhere(page: Path) -> None:
    """Every relative link names a file."""
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text())
    local = [target for target in targets if "://" not in target and not target.startswith("mailto:")]
    assert [target for target in local if not (page.parent / target).exists()] == []


def test_code_named_with_its_file_is_there() -> None:
    """Wherever a page says `name`, `other` (evaluator/file.py), or `name` in evaluator/file.py, that file has them."""
    pattern = re.compile(r"((?:`\w+`,\s)*`\w+`)\s(?:\(|in\s)((?:evaluator|bench)/[\w/]+\.py)")
    named = [
        (name, path)
        for page in PAGES
        for names, path in pattern.findall(page.read_text())
        for name in re.findall(r"\w+", names)
    ]
    assert len(named) > 20
    assert [(name, path) for name, path in named if not _defines(ROOT / path, name)] == []


def _defines(path: Path, name: str) -> bool:
    """Tell whether a module has a function, class or constant of this name."""
    return re.search(rf"^\s*(?:def |class )?{name}\b[ :(=]", path.read_text(), re.MULTILINE) is not None


def test_every_difference_between_the_protocols_has_its_formulas_and_its_effect() -> None:
    """Each numbered line of the bench has a section of that number and a row with the same words."""
    page = (ROOT / "docs" / "protocol.md").read_text()
    measured = [name for name in VARIANTS if re.match(r"\d+ (?!and |to )", name)]
    described = re.findall(r"^### (\d+)(?: and (\d+))? ", page, re.MULTILINE)
    assert [name.split()[0] for name in measured] == [number for pair in described for number in pair if number]
    assert [name for name in measured if f"\n| {name} | " not in page] == []


def test_every_page_can_be_found_from_the_first() -> None:
    """docs/index.md links every page beside it."""
    index = (ROOT / "docs" / "index.md").read_text()
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert {page for page in pages if f"({page})" not in index} == set()


def test_the_readme_names_real_commands() -> None:
    """`do.py` commands that the README and CONTRIBUTING show exist."""
    text = README + (ROOT / "CONTRIBUTING.md").read_text()
    shown = set(re.findall(r"python3 do\.py ([a-z]+)", text))
    assert shown <= {run.__name__ for run, _ in do.COMMANDS}


def test_the_readme_prints_what_it_shows(tmp_path: Path) -> None:
    """Its Python, run on a recorded case under the names it uses, prints the block that follows it."""
    script, printed = re.findall(r"<!-- printed -->\n```python\n(.*?)```\n```text\n(.*?)```", README, re.DOTALL)[0]
    case = ROOT / "tests" / "data" / "oracle" / "realistic60"
    shutil.copytree(case / "gt", tmp_path / "gtBbox3d" / "val")
    shutil.make_archive(str(tmp_path / "predictions"), "zip", case / "pred")

    ended = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )

    assert (ended.stderr, ended.stdout) == ("", printed)


def test_the_ways_into_the_evaluator_exist() -> None:
    """Each name in the docstring of the package is a function of the module named with it."""
    rows = re.findall(r"^    ([\w.]+)\.(\w+)(?:, (\w+))? {2,}", evaluator.__doc__ or "", re.MULTILINE)
    assert len(rows) > 5
    for module, *functions in rows:
        for function in filter(None, functions):
            assert callable(getattr(import_module(f"evaluator.{module}"), function))


def test_decisions_are_numbered_without_gaps() -> None:
    """Files in docs/decisions carry 0001, 0002, ... and a heading with the same number."""
    files = sorted((ROOT / "docs" / "decisions").glob("*.md"))
    for number, path in enumerate(files, start=1):
        assert path.name.startswith(f"{number:04d}-")
        assert path.read_text().startswith(f"# {number}. ")
