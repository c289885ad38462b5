"""Shards joined give what one evaluation of all images gives, byte for byte."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from evaluator.evaluation import evaluate, signature_of
from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.intake import read_predictions
from evaluator.integrity import audit
from evaluator.predictions import Predictions
from evaluator.protocol import CITYSCAPES3D, PROTOCOLS, Protocol
from evaluator.sharding import evaluate_shard, image_ranges, reduce_shards, shard_from_bytes, shard_to_bytes
from evaluator.synthetic import QUALITIES, synthesize_ground_truth, synthesize_predictions, write_zip

ORACLE = Path(__file__).parents[2] / "data" / "oracle"
SYNTHETIC = "synthetic"
CASES = (*sorted(path.name for path in ORACLE.iterdir() if path.is_dir()), SYNTHETIC)
SHARDS = (1, 2, 3, 7, 1000)
"""1000 is more than any case has images."""

RULES = [*PROTOCOLS.values(), msgspec.structs.replace(CITYSCAPES3D, modal=True)]


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[GroundTruth, Predictions]:
    """Ground truth and predictions of an oracle case, or of twenty imaginary images."""
    folder = ORACLE / request.param
    if request.param == SYNTHETIC:
        folder = tmp_path_factory.mktemp(SYNTHETIC)
        files = synthesize_ground_truth(20, seed=5)
        write_zip(files, folder / "gt")
        write_zip(synthesize_predictions(files, QUALITIES[-1], seed=6), folder / "pred")
    ground_truth = read_ground_truth(folder / "gt")
    predictions = read_predictions(folder / "pred", images=ground_truth.image_list()).predictions
    assert predictions is not None
    return ground_truth, predictions


def _whole(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol) -> tuple[bytes, ...]:
    evaluation = evaluate(ground_truth, predictions, protocol, ground_truth_sha256="g", predictions_sha256="p")
    encode = msgspec.json.encode
    return encode(evaluation.scores), evaluation.statistics.to_bytes(), encode(audit(evaluation))


def _sharded(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol, shards: int) -> tuple[bytes, ...]:
    """Go through bytes wherever the workers do."""
    kept = predictions.to_bytes()
    parts = [
        shard_to_bytes(evaluate_shard(ground_truth, Predictions.from_bytes(kept), protocol, images))
        for images in image_ranges(len(ground_truth.images), shards)
    ]
    signature = signature_of(protocol, "g", "p")
    reduction = reduce_shards([shard_from_bytes(part) for part in parts], Predictions.from_bytes(kept), signature)
    encode = msgspec.json.encode
    return encode(reduction.scores), reduction.statistics.to_bytes(), encode(reduction.integrity)


@pytest.mark.parametrize("protocol", RULES, ids=str)
def test_shards_give_the_same_bytes(case: tuple[GroundTruth, Predictions], protocol: Protocol) -> None:
    """Scores, statistics and integrity audit do not depend on the number of shards."""
    whole = _whole(*case, protocol)
    assert [shards for shards in SHARDS if _sharded(*case, protocol, shards) != whole] == []


@pytest.mark.parametrize("kept", [0, 1], ids=["no boxes at all", "boxes in one image in three"])
def test_shards_without_predictions_give_the_same_bytes(case: tuple[GroundTruth, Predictions], kept: int) -> None:
    """Images, whole shards and whole submissions without boxes are as good as any."""
    ground_truth, predictions = case
    rows = np.flatnonzero(predictions.image_index % 3 < kept)
    names = ("image_index", "label_index", "score", "center_m", "dimensions_m", "rotation", "amodal_px", "modal_px")
    sparse = replace(predictions, **{name: getattr(predictions, name)[rows] for name in names})
    if not kept:
        assert len(sparse) == 0
    whole = _whole(ground_truth, sparse, RULES[0])
    assert [shards for shards in SHARDS if _sharded(ground_truth, sparse, RULES[0], shards) != whole] == []


@pytest.mark.parametrize(
    ("images", "shards", "sizes"),
    [(7, 1, [7]), (7, 3, [2, 2, 3]), (3, 3, [1, 1, 1]), (3, 64, [1, 1, 1]), (1, 2, [1])],
)
def test_ranges_cover_every_image_once(images: int, shards: int, sizes: list[int]) -> None:
    """Ranges follow one another, differ by one image at most, and none is empty."""
    ranges = image_ranges(images, shards)
    assert [image for part in ranges for image in part] == list(range(images))
    assert [len(part) for part in ranges] == sizes
