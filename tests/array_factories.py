"""Build `GroundTruth` and `Predictions` by hand, box by box, for tests of what is computed from the arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from evaluator.ground_truth import GroundTruth
from evaluator.predictions import Predictions
from evaluator.projection import projected_corners_px
from evaluator.protocol import EVALUATED_LABELS

Triple = tuple[float, float, float]
Rectangle = tuple[float, float, float, float]

AWAY: Rectangle = (0.0, 0.0, 100.0, 100.0)


@dataclass(frozen=True, kw_only=True)
class Box:
    """One box, of ground truth or predicted; what one side does not know is left unused."""

    image: int = 0
    label: str = "car"
    center: Triple = (20.0, 0.0, 0.75)
    dimensions: Triple = (4.0, 2.0, 1.5)
    yaw: float = 0.0
    rotation: tuple[float, float, float, float] | None = None
    score: float = 1.0
    amodal: Rectangle = AWAY
    modal: Rectangle | None = None
    occlusion: float = 0.0
    truncation: float = 0.0
    prototype: str = "Sedan"

    def quaternion(self) -> tuple[float, float, float, float]:
        """Return w, x, y, z: `rotation` if given, else a turn by `yaw`."""
        return self.rotation or (float(np.cos(self.yaw / 2)), 0.0, 0.0, float(np.sin(self.yaw / 2)))


def image_names(count: int) -> tuple[str, ...]:
    """Return names in the data set's form, sorted."""
    return tuple(f"bonn_{index:06d}_000019" for index in range(count))


def _shared(boxes: Sequence[Box], labels: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the arrays both sides have."""
    return {
        "image_index": np.array([box.image for box in boxes], dtype=np.int32),
        "label_index": np.array([labels.index(box.label) for box in boxes], dtype=np.int32),
        "center_m": np.array([box.center for box in boxes], dtype=np.float64).reshape(-1, 3),
        "dimensions_m": np.array([box.dimensions for box in boxes], dtype=np.float64).reshape(-1, 3),
        "rotation": np.array([box.quaternion() for box in boxes], dtype=np.float64).reshape(-1, 4),
        "amodal_px": np.array([box.amodal for box in boxes], dtype=np.float64).reshape(-1, 4),
        "modal_px": np.array([box.modal or box.amodal for box in boxes], dtype=np.float64).reshape(-1, 4),
    }


def make_predictions(boxes: Sequence[Box], *, images: int = 1) -> Predictions:
    """Build predictions; boxes are put in the order of their images."""
    boxes = sorted(boxes, key=lambda box: box.image)
    return Predictions(
        images=image_names(images),
        labels=EVALUATED_LABELS,
        score=np.array([box.score for box in boxes], dtype=np.float64),
        **_shared(boxes, EVALUATED_LABELS),
    )


def make_ground_truth(
    boxes: Sequence[Box],
    *,
    images: int = 1,
    ignore: Sequence[tuple[int, Rectangle]] = (),
    camera: Triple = (0.0, 0.0, 0.0),
) -> GroundTruth:
    """Build ground truth; `ignore` lists (image, x y width height); all cameras stand at `camera` and look ahead."""
    boxes = sorted(boxes, key=lambda box: box.image)
    labels = tuple(sorted({box.label for box in boxes}))
    prototypes = tuple(sorted({box.prototype for box in boxes}))
    pose = np.hstack([np.eye(3), -np.array(camera)[:, None]])
    return GroundTruth(
        images=image_names(images),
        labels=labels,
        prototypes=prototypes,
        intrinsics_px=np.tile([2262.52, 2265.3, 1096.98, 513.137], (images, 1)),
        sensor_from_vehicle=np.tile(pose, (images, 1, 1)),
        prototype_index=np.array([prototypes.index(box.prototype) for box in boxes], dtype=np.int32),
        occlusion=np.array([box.occlusion for box in boxes], dtype=np.float64),
        truncation=np.array([box.truncation for box in boxes], dtype=np.float64),
        ignore_image_index=np.array([image for image, _ in ignore], dtype=np.int32),
        ignore_px=np.array([region for _, region in ignore], dtype=np.float64).reshape(-1, 4),
        **_shared(boxes, labels),
    )


def annotated(boxes: Sequence[Box], *, camera: Triple = (0.0, 0.0, 0.0)) -> list[Box]:
    """Return boxes whose amodal and modal rectangles are what the camera of `make_ground_truth` sees of them."""
    arrays = make_ground_truth(boxes, images=1 + max((box.image for box in boxes), default=0), camera=camera)
    x_min, y_min, x_max, y_max = projected_corners_px(
        arrays.center_m,
        arrays.dimensions_m,
        arrays.rotation,
        intrinsics_px=arrays.intrinsics_px,
        sensor_from_vehicle=arrays.sensor_from_vehicle,
        camera_index=arrays.image_index,
    )
    rectangles = np.column_stack([x_min, y_min, x_max - x_min, y_max - y_min]).tolist()
    ordered = sorted(boxes, key=lambda box: box.image)
    return [
        replace(box, amodal=tuple(rectangle), modal=tuple(rectangle))
        for box, rectangle in zip(ordered, rectangles, strict=True)
    ]


def scattered_boxes(
    seed: int,
    *,
    images: int,
    per_image: int = 8,
    labels: Sequence[str] = ("car", "bicycle"),
    spacing_m: tuple[float, float] = (9.0, 8.0),
) -> list[Box]:
    """Return ground-truth boxes on a disturbed grid ahead of the car; a narrow spacing makes them overlap."""
    rng = np.random.default_rng(seed)
    sizes = {"bicycle": (1.8, 0.6, 1.1), "motorcycle": (2.2, 0.8, 1.2)}
    boxes = []
    for image in range(images):
        for slot in rng.permutation(40)[:per_image]:
            label = labels[int(rng.integers(len(labels)))]
            ahead, left = spacing_m[0] * (slot % 8), spacing_m[1] * (slot // 8 - 2)
            center = (8.0 + ahead + rng.uniform(-1, 1), left + rng.uniform(-1, 1), 0.8)
            dimensions = tuple(float(side * rng.uniform(0.9, 1.1)) for side in sizes.get(label, (4.2, 1.8, 1.5)))
            boxes.append(
                Box(
                    image=image,
                    label=label,
                    center=center,
                    dimensions=dimensions,  # type: ignore[arg-type]  # three sides stay three
                    yaw=float(rng.uniform(-np.pi, np.pi)),
                    amodal=(float(rng.uniform(0, 1800)), float(rng.uniform(300, 700)), 120.0, 90.0),
                )
            )
    return boxes


def disturbed_boxes(seed: int, truth: Sequence[Box], *, images: int, spread: float = 1.0) -> list[Box]:
    """Return predictions for most of `truth`: displaced, resized, turned, some twice, some of nothing, scores distinct."""
    rng = np.random.default_rng(seed)
    found = [box for box in truth if rng.random() < 0.85]
    found += [box for box in truth if rng.random() < 0.25]
    found += [replace(box, image=int(rng.integers(images))) for box in truth if rng.random() < 0.3]
    boxes = []
    for box in found:
        error = rng.normal(0, 0.35 * spread, 3)
        center = (box.center[0] * (1 + rng.normal(0, 0.03 * spread)) + error[0], box.center[1] + error[1], 0.8)
        grown = tuple(float(side * np.exp(rng.normal(0, 0.06 * spread))) for side in box.dimensions)
        boxes.append(
            replace(
                box,
                center=center,
                dimensions=grown,  # type: ignore[arg-type]  # three sides stay three
                yaw=float(box.yaw + rng.normal(0, 0.1 * spread)),
                score=float(rng.uniform(0.02, 0.999)),
            )
        )
    return boxes
