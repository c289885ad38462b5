"""Protocols: frozen, named, versioned sets of evaluation rules, and the signature printed with every score."""

import msgspec

EVALUATOR_VERSION = "1"
"""Raised whenever any number that any protocol yields may change."""

VEHICLE_LABELS = ("car", "truck", "bus", "train", "motorcycle", "bicycle", "caravan", "trailer")
"""All classes of the data set (paper, section Dataset Analysis)."""

EVALUATED_LABELS = VEHICLE_LABELS[:6]
"""The classes that rank; caravan and trailer are ignored (paper, section Dataset Analysis)."""


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
