"""The JSON of ground-truth and prediction files as the data set writes it, and zips of such files."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import msgspec

Box2dPx = tuple[float, float, float, float]


class Sensor(msgspec.Struct, frozen=True, rename={"sensor_from_vehicle": "sensor_T_ISO_8855"}):
    """The camera of one image."""

    fx: float
    fy: float
    u0: float
    v0: float
    baseline: float
    sensor_from_vehicle: list[list[float]]


class Boxes2d(msgspec.Struct, frozen=True):
    """Visible and whole extent: x, y of the upper left corner, width, height."""

    modal: Box2dPx
    amodal: Box2dPx


class Box3d(msgspec.Struct, frozen=True, omit_defaults=True):
    """A box in the vehicle frame: metres, quaternion w, x, y, z."""

    center: tuple[float, float, float]
    dimensions: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    type: str | None = None
    format: str | None = None


class AnnotatedObject(msgspec.Struct, frozen=True, rename={"boxes_2d": "2d", "box_3d": "3d"}):
    """One annotated vehicle."""

    boxes_2d: Boxes2d
    box_3d: Box3d
    occlusion: float
    truncation: float
    instanceId: int  # noqa: N815 (the data set's spelling)
    label: str
    score: float = 1.0


class IgnoreRegion(msgspec.Struct, frozen=True, rename={"box_px": "2d"}):
    """A region in which unmatched predictions do not count."""

    box_px: Box2dPx
    label: str = "vehicle group"
    instanceId: int = -1  # noqa: N815 (likewise)


class GroundTruthFile(msgspec.Struct, frozen=True):
    """The annotation of one image."""

    imgWidth: int  # noqa: N815 (likewise)
    imgHeight: int  # noqa: N815 (likewise)
    sensor: Sensor
    objects: list[AnnotatedObject]
    ignore: list[IgnoreRegion]


class PredictedObject(msgspec.Struct, frozen=True, rename={"boxes_2d": "2d", "box_3d": "3d"}):
    """One detection."""

    boxes_2d: Boxes2d
    box_3d: Box3d
    label: str
    score: float


class PredictionFile(msgspec.Struct, frozen=True):
    """A method's answer for one image."""

    objects: list[PredictedObject]


def write_zip(files: Mapping[str, bytes], path: Path) -> None:
    """Write files into a deflated zip; equal files give equal bytes."""
    with zipfile.ZipFile(path, "w") as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, files[name], zipfile.ZIP_DEFLATED, compresslevel=6)
