"""The golden ledger: scores of fixed inputs under every protocol, with why each of them ever moved."""

import json
from pathlib import Path
from typing import Any

import pytest

from evaluator.evaluation import evaluate
from evaluator.ground_truth import read_ground_truth
from evaluator.protocol import EVALUATOR_VERSION, PROTOCOLS
from evaluator.results import Scores
from tests.prediction_arrays import load_predictions

DATA = Path(__file__).parents[2] / "data"
LEDGER: dict[str, list[dict[str, Any]]] = json.loads((DATA / "golden_ledger.json").read_text())
MEANS = ("mds", "map", "mbevcd", "myaw_sim", "mpr_sim", "msize_sim")


def _scores(name: str) -> Scores:
    protocol_name, case = name.split("/")
    protocol = PROTOCOLS[protocol_name]
    ground_truth = read_ground_truth(DATA / "oracle" / case / "gt")
    predictions = load_predictions(DATA / "oracle" / case / "pred", ground_truth.images, protocol.labels)
    return evaluate(ground_truth, predictions, protocol).scores


@pytest.mark.parametrize("name", sorted(LEDGER))
def test_scores_are_those_of_the_last_entry(name: str) -> None:
    """A changed number needs a new entry that says why, and a new evaluator or protocol version."""
    latest = LEDGER[name][-1]
    scores = _scores(name)

    assert {mean: getattr(scores, mean) for mean in MEANS} == pytest.approx(
        {mean: latest[mean] for mean in MEANS}, abs=1e-12
    )
    assert (latest["evaluator_version"], latest["protocol_version"]) == (
        EVALUATOR_VERSION,
        scores.signature.protocol.version,
    )


def test_every_protocol_has_entries_and_every_entry_a_reason() -> None:
    """No protocol goes unwatched, and no number moves without a word."""
    assert {name.split("/")[0] for name in LEDGER} == set(PROTOCOLS)
    assert all(entry["why"] for entries in LEDGER.values() for entry in entries)
