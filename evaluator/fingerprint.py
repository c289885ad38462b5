"""Recognises predictions that are nearly those of another submission, without keeping the predictions.

MinHash (Broder, 1997): each box becomes a token of its image, its class and the half-metre cell of its centre; of
each of 128 hash functions the smallest value over all tokens is kept. The share of equal values in two fingerprints
estimates how many tokens two submissions share. Scores, sizes and angles do not matter, so rescored copies are found.
"""

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array, Predictions

HASHES = 128
CELL_M = 0.5
"""Copies with a centimetre of noise keep nine of ten tokens; independent detectors rarely share one in four."""
_BLOCK = 1024
"""Tokens hashed at a time: 128 hashes of each stay within a processor's cache."""

Words = NDArray[np.uint64]


def fingerprint(predictions: Predictions) -> str:
    """Compute the fingerprint: 128 hash values of 16 hexadecimal digits each; empty without boxes."""
    if not len(predictions):
        return ""
    tokens = _tokens(predictions)
    factors, summands = _mixed(np.arange(1, 2 * HASHES + 1, dtype=np.uint64)).reshape(2, HASHES, 1)
    least = np.full(HASHES, np.iinfo(np.uint64).max, dtype=np.uint64)
    for start in range(0, len(tokens), _BLOCK):
        hashed = _mixed(tokens[None, start : start + _BLOCK] * (factors | np.uint64(1)) + summands)
        least = np.minimum(least, hashed.min(axis=1))
    return "".join(f"{value:016x}" for value in least.tolist())


def similarity(first: str, second: str) -> float:
    """Estimate how much of two submissions is the same, as `similarities` does."""
    return float(similarities(first, [second])[0])


def similarities(one: str, others: Sequence[str]) -> Float64Array:
    """Estimate how much of a submission is the same in each of others.

    Args:
        one: a fingerprint.
        others: more of them.

    Returns:
        (N,) shares in [0, 1]: 1 for the same boxes, 0 for nothing in common or when one of the two is empty.
    """
    equal: Float64Array = np.mean(_hashes(others) == _hashes([one]), axis=1)
    return equal * bool(one)


def _hashes(fingerprints: Sequence[str]) -> NDArray[np.bytes_]:
    """Separate the hash values of fingerprints, (N, 128), each as its 16 digits; of an empty one they equal none."""
    width = 16 * HASHES
    text = "".join(fingerprint.ljust(width, "-") for fingerprint in fingerprints)
    return np.frombuffer(text.encode(), dtype="S16").reshape(-1, HASHES)


def _tokens(predictions: Predictions) -> Words:
    """Make a token of each box, (N,)."""
    images = np.array([_name_hash(name) for name in predictions.images], dtype=np.uint64)
    labels = np.array([_name_hash(name) for name in predictions.labels], dtype=np.uint64)
    tokens = images[predictions.image_index] ^ _mixed(labels[predictions.label_index])
    for column in np.floor(predictions.center_m / CELL_M).astype(np.int64).T:
        tokens = _mixed(tokens ^ column.astype(np.uint64))
    return tokens


def _name_hash(name: str) -> int:
    """Hash a name the same way everywhere."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")


def _mixed(words: Words) -> Words:
    """Scramble the bits of each word (the finaliser of splitmix64, Steele et al. 2014); overflow is meant."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))
