"""A protocol whose parameters have no meaning is refused before anything is computed."""

import math
from typing import Any

import pytest
from msgspec.structs import replace

from evaluator.errors import UsageError
from evaluator.evaluation import evaluate
from evaluator.protocol import CITYSCAPES3D, PAPER, PROTOCOLS, Protocol
from tests.array_factories import Box, annotated, make_ground_truth, make_predictions

CAR = annotated([Box()])
both = pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=lambda protocol: str(protocol.name))


@both
@pytest.mark.parametrize(
    "changed",
    [
        {"labels": ()},
        {"labels": "car"},
        {"min_iou": math.nan},
        {"min_iou": math.inf},
        {"min_iou": 1.01},
        {"min_iou": -0.1},
        {"max_depth_m": 0},
        {"max_depth_m": -5},
        {"max_depth_m": 10_001, "depth_step_m": 1},
        {"depth_step_m": 0},
        {"depth_step_m": 2.5},
        {"max_depth_m": 100.0},
        {"score_steps": math.nan},
        {"depth_step_m": -1},
        {"score_steps": 0},
        {"score_steps": -1},
        {"score_steps": 63},
        {"working_point": math.nan},
        {"working_point": math.inf},
        {"working_point": 1.0, "score_steps": 49},
    ],
    ids=str,
)
def test_a_parameter_without_meaning_is_wrong_usage(protocol: Protocol, changed: dict[str, Any]) -> None:
    """The message names the parameter; no score comes of it."""
    with pytest.raises(UsageError, match=next(iter(changed))):
        evaluate(make_ground_truth(CAR), make_predictions(CAR), replace(protocol, **changed))


@pytest.mark.parametrize(
    ("name", "version"), [("papr", "1"), ("Paper", "1"), ("cityscapes3d", "7"), ("", ""), ("paper", "2")]
)
def test_rules_that_do_not_exist_are_wrong_usage(name: str, version: str) -> None:
    """A signature names the rules that were used, so no others can be asked for; the message lists those there are."""
    with pytest.raises(UsageError, match="only cityscapes3d:1, paper:1"):
        evaluate(make_ground_truth(CAR), make_predictions(CAR), Protocol(name=name, version=version))


def test_modal_boxes_have_no_place_in_the_paper() -> None:
    """A result signed `paper:1+modal=True` would claim what nothing computes."""
    with pytest.raises(UsageError, match="modal"):
        evaluate(make_ground_truth(CAR), make_predictions(CAR), replace(PAPER, modal=True))


@both
@pytest.mark.parametrize(
    "changed",
    [
        {"labels": ("person",)},
        {"min_iou": 0.0},
        {"max_depth_m": 1, "depth_step_m": 250},
        {"max_depth_m": 10_000, "depth_step_m": 1},
        {"score_steps": 1},
        {"score_steps": 62},
        {"score_steps": 49},
        {"working_point": 0.99, "score_steps": 49},
        {"working_point": -0.5},
        {"working_point": 1.3},
    ],
    ids=str,
)
def test_unusual_parameters_with_a_meaning_are_evaluated(protocol: Protocol, changed: dict[str, Any]) -> None:
    """At the limits of what is allowed, perfect predictions have a perfect AP; a class nobody annotated has none."""
    scores = evaluate(make_ground_truth(CAR), make_predictions(CAR), replace(protocol, **changed)).scores

    assert scores.map == (None if changed.get("labels") else pytest.approx(1.0))


@both
def test_different_images_are_refused(protocol: Protocol) -> None:
    """Each protocol says what both sides must share."""
    with pytest.raises(UsageError, match="same images"):
        evaluate(make_ground_truth(CAR, images=2), make_predictions(CAR), protocol)


def test_the_published_protocols_differ_in_nothing_but_their_name() -> None:
    """Their parameters are equal; what `paper` does otherwise hangs on its name."""
    assert replace(PAPER, name="cityscapes3d") == CITYSCAPES3D
