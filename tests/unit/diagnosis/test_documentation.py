"""docs/diagnosis.md and docs/comparison.md name what the code has."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from evaluator.diagnosis.annotator_noise import ANNOTATOR_NOISE
from evaluator.diagnosis.causes import FALSE_POSITIVE_CAUSES
from evaluator.diagnosis.errors import ERROR_NAMES
from evaluator.diagnosis.oracles import ORACLES
from evaluator.diagnosis.subsets import memberships
from tests.array_factories import make_ground_truth

DOCS = Path(__file__).parents[3] / "docs"
DIAGNOSIS = (DOCS / "diagnosis.md").read_text()
COMPARISON = (DOCS / "comparison.md").read_text()
GROUPINGS = tuple(part.name for part in memberships(make_ground_truth([])))


@pytest.mark.parametrize("name", [*ERROR_NAMES, *FALSE_POSITIVE_CAUSES, "missed", *ORACLES, *GROUPINGS])
def test_every_name_of_the_diagnosis_is_explained(name: str) -> None:
    """Errors, causes, oracles and groupings are all in the document."""
    assert f"`{name}`" in DIAGNOSIS


def test_the_annotators_errors_are_those_of_the_code() -> None:
    """The table in the document holds the constants."""
    for row in ([noise.yaw_deg for noise in ANNOTATOR_NOISE], [noise.center_m for noise in ANNOTATOR_NOISE]):
        assert " | ".join(f"{value:.2f}" for value in row) in DIAGNOSIS


def test_every_function_named_for_a_comparison_metric_exists() -> None:
    """`module.function` in the document is a function of that module."""
    folder = Path(__file__).parents[3] / "evaluator" / "comparison"
    modules = "|".join(path.stem for path in folder.glob("[a-z]*.py"))
    named = re.findall(rf"`({modules})\.(\w+)`", COMPARISON)
    assert len(named) > 20
    for module, function in named:
        assert callable(getattr(import_module(f"evaluator.comparison.{module}"), function)), (module, function)
