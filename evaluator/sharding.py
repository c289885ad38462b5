"""Evaluation of one submission shard by shard: each a range of its images, by whatever process, joined bit for bit.

A shard is a pure function of the predictions, the ground truth, the protocol and the range. All shards joined give
scores, statistics and integrity audit with the same bytes as one evaluation of all images.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec

from evaluator.evaluation import match_by_protocol, score_by_protocol, signature_of
from evaluator.ground_truth import GroundTruth
from evaluator.integrity import IntegrityAudit, Variant, Variants, audit_variants, collect_variants, evenly_spread
from evaluator.parts import ground_truth_of, predictions_of
from evaluator.predictions import Predictions
from evaluator.protocol import Protocol, Signature
from evaluator.results import Scores
from evaluator.statistics import Statistics, collect, join


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduction:
    """What all shards come to."""

    scores: Scores
    statistics: Statistics
    integrity: IntegrityAudit


def image_ranges(images: int, shards: int) -> list[range]:
    """Divide the images into ranges that differ by one image at most.

    Args:
        images: At least 1.
        shards: At least 1; with more than images, each image is a range.
    """
    count = min(shards, images)
    bounds = [images * number // count for number in range(count + 1)]
    return [range(first, end) for first, end in itertools.pairwise(bounds)]


def evaluate_shard(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol, images: range) -> Variants:
    """Match the images of one range.

    Args:
        ground_truth: Of all images.
        predictions: Of all images; only their scores matter beyond the range, for the audit.
        protocol: The rules.
        images: Which.
    """
    part = slice(images.start, images.stop)
    truth, own = ground_truth_of(ground_truth, part), predictions_of(predictions, part)
    first = predictions.image_index.searchsorted(images.start)
    spread = evenly_spread(predictions)[first : first + len(own)]
    official = collect(truth, own, match_by_protocol(truth, own, protocol), signature_of(protocol))
    return collect_variants(truth, own, official, spread)


def reduce_shards(shards: Sequence[Variants], predictions: Predictions, signature: Signature) -> Reduction:
    """Join all shards and score.

    Args:
        shards: Of all ranges, in their order.
        predictions: Of all images.
        signature: What the scores depend on; stored with them and with the statistics.
    """
    variants = {name: join([shard[name] for shard in shards]) for name in shards[0]}
    variants["official"] = replace(variants["official"], signature=signature)
    scores = score_by_protocol(variants["official"])
    return Reduction(
        scores=scores,
        statistics=variants["official"],
        integrity=audit_variants(variants, predictions, scores),
    )


def shard_to_bytes(variants: Variants) -> bytes:
    """Write a shard's result to deterministic bytes."""
    return msgspec.msgpack.encode({name: statistics.to_bytes() for name, statistics in variants.items()})


def shard_from_bytes(data: bytes) -> Variants:
    """Read what `shard_to_bytes` wrote."""
    files = msgspec.msgpack.decode(data, type=dict[Variant, bytes])
    return {name: Statistics.from_bytes(content) for name, content in files.items()}
