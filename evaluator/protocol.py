"""Protocols: frozen, named, versioned sets of evaluation rules, and the signature printed with every score."""

import math
from collections.abc import Iterator

import msgspec

from evaluator.errors import UsageError

EVALUATOR_VERSION = "1"
"""Raised whenever any number that any protocol yields may change."""

VEHICLE_LABELS = ("car", "truck", "bus", "train", "motorcycle", "bicycle", "caravan", "trailer")
"""All classes of the data set (paper, section Dataset Analysis)."""

EVALUATED_LABELS = VEHICLE_LABELS[:6]
"""The classes that rank; caravan and trailer are ignored (paper, section Dataset Analysis)."""

MOST_SCORE_STEPS = 62
"""Their 63 thresholds are what a mask of 64 bits holds with one to spare, so that 2^n - 1 never overflows."""

FEWEST_BINS = 2
"""With fewer depth bins holding a true positive the reference makes every similarity 0, so `cityscapes3d` does."""

MOST_DEPTH_BINS = 10_000
"""More only fill the memory: detections end at 10 km."""


class Protocol(msgspec.Struct, frozen=True, kw_only=True):
    """One way to turn predictions and ground truth into scores. Two equal protocols give equal scores."""

    name: str
    version: str
    labels: tuple[str, ...] = EVALUATED_LABELS
    min_iou: float = 0.7
    """A match needs an IoU strictly above this; so does the overlap with an ignore region."""
    max_depth_m: int = 100
    depth_step_m: int = 5
    score_steps: int = 50
    """Score thresholds are `numpy.arange(0, 1.01, 1 / score_steps)`: 51 of them."""
    working_point: float | None = None
    """Fixed c_w for every class, or None: the lowest threshold with the greatest precision x recall."""
    modal: bool = False
    """Match the submitted modal boxes instead of the projected amodal ones."""

    @property
    def depth_bins_m(self) -> tuple[int, ...]:
        """Lower edges of the depth bins, in metres."""
        return tuple(range(0, self.max_depth_m, self.depth_step_m))

    def __str__(self) -> str:
        """Print name and version, and every parameter that differs from the published protocol of that name."""
        published = PROTOCOLS.get(self.name, CITYSCAPES3D)
        changed = {
            field: getattr(self, field)
            for field in self.__struct_fields__[2:]
            if getattr(self, field) != getattr(published, field)
        }
        changes = (
            f"+{name}={','.join(value) if isinstance(value, tuple) else value}" for name, value in changed.items()
        )
        return f"{self.name}:{self.version}{''.join(changes)}"


CITYSCAPES3D = Protocol(name="cityscapes3d", version="1")
"""The published protocol: equal to `cityscapesscripts` 2.3.0 to 1e-9 on every number. It ranks."""

PAPER = Protocol(name="paper", version="1")
"""The paper's formulas literally (docs/protocol.md lists every difference)."""

PROTOCOLS = {protocol.name: protocol for protocol in (CITYSCAPES3D, PAPER)}


def require_usable(protocol: Protocol) -> None:
    """Refuse a protocol whose parameters have no meaning.

    Raises:
        UsageError: Names the first such parameter, and what it may be.
    """
    for usable, message in _requirements(protocol):
        if not usable:
            raise UsageError(message)


def _requirements(protocol: Protocol) -> Iterator[tuple[bool, str]]:
    """Yield what must hold, and what to say where it does not; each may rely on the ones before it."""
    rules = (protocol.name, protocol.version)
    published = [(one.name, one.version) for one in PROTOCOLS.values()]
    names = ", ".join(map(":".join, published))
    yield rules in published, f"there are no rules called {':'.join(rules)}, only {names}; change parameters alone."
    yield isinstance(protocol.labels, tuple), "labels must be a tuple of names of classes, like ('car', 'bus')."
    yield len(protocol.labels) > 0, "labels must name at least one class."
    yield 0 <= protocol.min_iou <= 1, "min_iou must be from 0 to 1, as an IoU is."
    for name in ("max_depth_m", "depth_step_m", "score_steps"):
        yield isinstance(getattr(protocol, name), int), f"{name} must be a whole number."
    yield protocol.max_depth_m >= 1, "max_depth_m must be at least 1 metre."
    yield protocol.depth_step_m >= 1, "depth_step_m must be at least 1 metre."
    bins = protocol.max_depth_m / protocol.depth_step_m
    yield bins <= MOST_DEPTH_BINS, f"max_depth_m / depth_step_m must not exceed {MOST_DEPTH_BINS}."
    yield 1 <= protocol.score_steps <= MOST_SCORE_STEPS, f"score_steps must be from 1 to {MOST_SCORE_STEPS}."
    fixed = protocol.working_point or 0.0
    yield math.isfinite(fixed), "working_point must be a score, a finite number."
    highest = protocol.score_steps * (1.0 / protocol.score_steps)  # 49 of them end at 0.9999999999999999
    yield min(fixed, 1.0) <= highest, f"working_point is above the last threshold, {highest}; change score_steps."
    modal = protocol.modal and protocol.name == PAPER.name
    yield not modal, "modal has no meaning in the protocol paper, which matches projected boxes; leave it out."


class Signature(msgspec.Struct, frozen=True, kw_only=True):
    """Everything a score depends on; equal signatures mean comparable, reproducible numbers."""

    protocol: Protocol
    evaluator_version: str
    ground_truth_sha256: str
    predictions_sha256: str

    def __str__(self) -> str:
        """Print the signature on one line, for citing beside a number."""
        return (
            f"{self.protocol}|evaluator:{self.evaluator_version}"
            f"|gt:{self.ground_truth_sha256[:12]}|pred:{self.predictions_sha256[:12]}"
        )


def require_comparable(first: Signature, second: Signature) -> None:
    """Refuse two results that depend on more than the predictions.

    Raises:
        UsageError: They come from other protocols or versions of the evaluator, or from other ground truth.
    """
    if (first.protocol, first.evaluator_version) != (second.protocol, second.evaluator_version):
        raise UsageError(f"Score both submissions by one protocol: {first} and {second} differ.")
    if first.ground_truth_sha256 != second.ground_truth_sha256:
        raise UsageError("Score both submissions against the same ground truth; their differences mean nothing else.")
