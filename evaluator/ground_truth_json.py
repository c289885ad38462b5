"""One ground-truth file (`*_gtBbox3d.json`): its typed shape, and decoding with every problem found in it.

Only what the evaluation uses is declared; other keys are allowed and skipped.
Reference: `Box3dEvaluator.loadGT`, `CsBbox3d.fromJsonText`, `CsIgnore2d.fromJsonText`.
"""

import math
from collections.abc import Iterator

import msgspec

from evaluator.value_ranges import CENTER_LIMIT_M, ROTATION_NORM_RANGE, center_is_valid

Four = tuple[float, float, float, float]
Three = tuple[float, float, float]


class Sensor(msgspec.Struct, gc=False):
    """The camera of one image."""

    fx: float
    fy: float
    u0: float
    v0: float
    sensor_T_ISO_8855: tuple[Four, Four, Four]  # noqa: N815 - the file format's key


class Box2d(msgspec.Struct, gc=False):
    """Boxes x, y, width, height in pixels; `bbox` with `bboxVis` is the CityPersons spelling and goes first."""

    amodal: Four | None = None
    modal: Four | None = None
    bbox: Four | None = None
    bboxVis: Four | None = None  # noqa: N815 - the file format's key

    def amodal_and_modal(self) -> tuple[Four, Four] | None:
        """Return both boxes, the amodal one twice where there is no modal one; None when there is neither."""
        if self.bbox is not None and self.bboxVis is not None:
            return self.bbox, self.bboxVis
        if self.amodal is None:
            return None
        return self.amodal, self.modal or self.amodal


class Box3d(msgspec.Struct, gc=False):
    """Centre and dimensions in metres in the vehicle frame, rotation as quaternion w, x, y, z."""

    center: Three
    dimensions: Three
    rotation: Four
    type: str | None = None


class Object(msgspec.Struct, gc=False):
    """One annotated vehicle."""

    label: str
    box_2d: Box2d = msgspec.field(name="2d")
    box_3d: Box3d = msgspec.field(name="3d")
    occlusion: float | None = None
    truncation: float | None = None


class IgnoreRegion(msgspec.Struct, gc=False):
    """One region in which unmatched detections do not count: x, y, width, height in pixels."""

    box_2d: Four = msgspec.field(name="2d")


class Document(msgspec.Struct, gc=False):
    """One image's ground truth."""

    sensor: Sensor
    objects: list[Object]
    ignore: list[IgnoreRegion]


_DECODER = msgspec.json.Decoder(Document)


def decode(data: bytes) -> Document:
    """Decode one file.

    Raises:
        msgspec.DecodeError: It is not JSON or not of this shape; the message has the place.
        UnicodeDecodeError: It is not UTF-8.
    """
    return _DECODER.decode(data)


def problems(document: Document) -> Iterator[str]:
    """Yield what is wrong in a decoded file, each with its JSON pointer."""
    sensor = document.sensor
    numbers = [sensor.fx, sensor.fy, *(value for row in sensor.sensor_T_ISO_8855 for value in row)]
    if not all(map(math.isfinite, numbers)) or min(sensor.fx, sensor.fy) <= 0:
        yield "/sensor: focal lengths must be positive and all numbers finite"
    for index, item in enumerate(document.objects):
        for problem in _object_problems(item):
            yield f"/objects/{index}/{problem}"


def _object_problems(item: Object) -> Iterator[str]:
    if item.box_2d.amodal_and_modal() is None:
        yield "2d: needs the amodal box as [x, y, width, height]"
    if min(item.box_3d.dimensions) <= 0:
        yield f"3d/dimensions: {list(item.box_3d.dimensions)} must all be greater than 0 metres"
    if not center_is_valid(item.box_3d.center):
        yield f"3d/center: {list(item.box_3d.center)} must lie within {CENTER_LIMIT_M:.0f} metres"
    length = math.hypot(*item.box_3d.rotation)
    if not ROTATION_NORM_RANGE[0] <= length <= ROTATION_NORM_RANGE[1]:
        yield f"3d/rotation: the quaternion [w, x, y, z] has the length {length:g}; it should be 1"
