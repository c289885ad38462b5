"""Numbers that may not move: the golden ledger of scores, with why each ever did, and intervals of the default draw."""

import json
from pathlib import Path
from typing import Any

import pytest

from evaluator.evaluation import Evaluation, evaluate
from evaluator.ground_truth import read_ground_truth
from evaluator.protocol import EVALUATOR_VERSION, PROTOCOLS
from evaluator.uncertainty import Method, intervals
from tests.prediction_arrays import load_predictions

DATA = Path(__file__).parents[2] / "data"
LEDGER: dict[str, list[dict[str, Any]]] = json.loads((DATA / "golden_ledger.json").read_text())
MEANS = ("mds", "map", "mbevcd", "myaw_sim", "mpr_sim", "msize_sim")


def _evaluate(name: str) -> Evaluation:
    protocol_name, case = name.split("/")
    protocol = PROTOCOLS[protocol_name]
    ground_truth = read_ground_truth(DATA / "oracle" / case / "gt")
    predictions = load_predictions(DATA / "oracle" / case / "pred", ground_truth.images, protocol.labels)
    return evaluate(ground_truth, predictions, protocol)


@pytest.mark.parametrize("name", sorted(LEDGER))
def test_scores_are_those_of_the_last_entry(name: str) -> None:
    """A changed number needs a new entry that says why, and a new evaluator or protocol version."""
    latest = LEDGER[name][-1]
    scores = _evaluate(name).scores

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


@pytest.mark.parametrize(
    ("method", "mds", "car_ap"),
    [
        ("bca", (0.4366099854692708, 0.6963114951773014), (0.7804029891738526, 0.8642655217267621)),
        ("percentile", (0.47629877767592793, 0.7124083188657502), (0.7913519540338259, 0.8706836892781293)),
    ],
)
def test_everybody_gets_the_same_interval(
    method: Method, mds: tuple[float, float], car_ap: tuple[float, float]
) -> None:
    """The default seed and the draw are part of the interface: a published interval can be computed again."""
    found = intervals(_evaluate("cityscapes3d/realistic60").statistics, method=method, unproven=True)
    for interval, bounds in ((found.means["mds"], mds), (found.classes["car"]["ap"], car_ap)):
        assert interval is not None
        assert (interval.lower, interval.upper) == pytest.approx(bounds, abs=1e-9)
