"""Ground truth as arrays: cameras, boxes and ignore regions of a set of images; reading and storing it."""

import hashlib
import os
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Never, Self

import msgspec
import numpy as np

from evaluator import array_file, ground_truth_json
from evaluator.decoding import garbage_collection_paused
from evaluator.errors import DataError
from evaluator.predictions import Float64Array, IndexArray

_LISTED_PROBLEMS = 50
"""Problems printed one by one in an error message; the rest are counted."""
_UNREADABLE = (OSError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError)
"""What `zipfile` and the file system raise: damaged or encrypted members, unknown compression, no permission."""


class GroundTruthError(DataError):
    """The ground truth cannot be used; the message lists every file and place that is wrong."""

    code = "invalid_ground_truth"


class ImageList(msgspec.Struct, frozen=True, kw_only=True):
    """The public part of ground truth: which images there are, and their cameras."""

    images: tuple[str, ...]
    """Image names, sorted."""
    intrinsics_px: tuple[tuple[float, float, float, float], ...]
    """fx, fy, u0, v0 for each image."""
    sensor_from_vehicle: tuple[tuple[tuple[float, float, float, float], ...], ...]
    """3 x 4 for each image."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundTruth:
    """Cameras, boxes and ignore regions of all images. Frame and box layout as in `Predictions`.

    Boxes are ordered by image, then as they stand in the image's file; likewise ignore regions.
    """

    images: tuple[str, ...]
    """Image names `<city>_<sequence>_<frame>`, sorted."""
    labels: tuple[str, ...]
    """What `label_index` refers to: every label that occurs in the files."""
    prototypes: tuple[str, ...]
    """What `prototype_index` refers to: the size prototypes of the paper's table (the files' `type`)."""

    intrinsics_px: Float64Array
    """(I, 4) fx, fy, u0, v0 of each image's camera."""
    sensor_from_vehicle: Float64Array
    """(I, 3, 4) `sensor_T_ISO_8855`: vehicle frame to camera frame (x forward, y left, z up)."""

    image_index: IndexArray
    """(N,) int32, ascending, index into `images`."""
    label_index: IndexArray
    """(N,) int32, index into `labels`."""
    prototype_index: IndexArray
    """(N,) int32, index into `prototypes`, -1 where the file names none."""
    center_m: Float64Array
    dimensions_m: Float64Array
    rotation: Float64Array
    amodal_px: Float64Array
    modal_px: Float64Array
    occlusion: Float64Array
    """(N,) in [0, 1], NaN where the file says nothing."""
    truncation: Float64Array
    """(N,) in [0, 1], NaN where the file says nothing."""

    ignore_image_index: IndexArray
    """(R,) int32, ascending, index into `images`."""
    ignore_px: Float64Array
    """(R, 4) ignore regions: x, y of the upper left corner, width, height."""

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.image_index)

    def image_list(self) -> ImageList:
        """Return what participants may know: names and cameras, no boxes."""
        return ImageList(
            images=self.images,
            intrinsics_px=tuple(map(tuple, self.intrinsics_px.tolist())),
            sensor_from_vehicle=tuple(tuple(map(tuple, matrix)) for matrix in self.sensor_from_vehicle.tolist()),
        )

    def to_bytes(self) -> bytes:
        """Write everything to deterministic bytes (evaluator/array_file.py), for a blob named by its digest."""
        return array_file.pack_fields(self)

    def sha256(self) -> str:
        """Compute the digest of `to_bytes`, which names the ground truth in signatures."""
        return hashlib.sha256(self.to_bytes()).hexdigest()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read what `to_bytes` wrote.

        Raises:
            ArrayFileError: The bytes are something else or are cut short.
        """
        return cls(**array_file.unpack_fields(data, cls, what="ground truth"))


def image_name(file_name: str) -> str | None:
    """Return the image a file belongs to: its base name up to the last "_" (reference: `loadGT`).

    None for a name without "_", which belongs to no image.
    """
    base, separator, _ = PurePosixPath(file_name).name.rpartition("_")
    return base if separator and base else None


def read_ground_truth(source: Path) -> GroundTruth:
    """Read a folder or zip of `<city>_<sequence>_<frame>_<anything>.json` files, in any sub folders.

    `results.json` and macOS's `._*` lie beside ground truth and are no part of it. Whatever else looks like ground truth
    but is named otherwise (`.JSON`, `_gtBbox3d.json.bak`), and links to folders, are errors: nothing is left out in silence.

    Args:
        source: A folder or a zip file.

    Returns:
        The ground truth of all images, sorted by name.

    Raises:
        GroundTruthError: Files are missing, unreadable or wrong; all of them are listed.
    """
    try:
        with garbage_collection_paused():
            return _read(source)
    except _UNREADABLE as error:
        raise GroundTruthError(
            f"{source} cannot be read ({error}); pack it again with an ordinary zip program, without a password."
            if source.is_file()
            else f"{source} cannot be read ({error}); check its permissions."
        ) from error


def ground_truth_files(source: Path) -> dict[str, bytes]:
    """Return what `read_ground_truth` takes from a folder or zip that it has read: the files' bytes by base name.

    No two have one name: they would be for one image.
    """
    return {PurePosixPath(name).name: data for name, data in _json_files(source, [])}


def _read(source: Path) -> GroundTruth:
    documents: dict[str, ground_truth_json.Document] = {}
    found: list[str] = []
    for file_name, data in _json_files(source, found):
        image = image_name(file_name)
        if image is None:
            found.append(f"{file_name}: name it <city>_<sequence>_<frame>_gtBbox3d.json")
        elif image in documents:
            found.append(f"{file_name}: a second file for image {image}; keep one")
        else:
            documents[image] = _decode(file_name, data, found)
    if not documents and not found:
        found.append(f"{source}: no *_gtBbox3d.json files in there")
    if found:
        raise GroundTruthError(_message(found))
    return _assemble(dict(sorted(documents.items())))


def _json_files(source: Path, found: list[str]) -> Iterator[tuple[str, bytes]]:
    """Yield names and bytes in sorted order; `found` receives what only looks like ground truth."""
    if source.is_dir():
        for name in sorted(_names_below(source, found)):
            if not _is_wanted(name, found):
                continue
            if (source / name).is_file():
                yield name, (source / name).read_bytes()
            else:  # reading from a pipe would wait for its other end
                found.append(f"{name}: no regular file; put the file itself there")
    elif zipfile.is_zipfile(source):
        with zipfile.ZipFile(source) as archive:
            for name in sorted(archive.namelist()):
                if _is_wanted(name, found):
                    yield name, archive.read(name)
    else:
        raise GroundTruthError(f"{source} is neither a folder nor a zip file; give one of the two.")


def _names_below(root: Path, found: list[str]) -> Iterator[str]:
    """Yield the relative names of all files; a folder that cannot be listed is an error, unlike with `rglob`."""

    def fail(error: OSError) -> Never:
        raise error

    for folder, folders, files in os.walk(root, onerror=fail):
        linked = [name for name in folders if Path(folder, name).is_symlink()]
        found.extend(f"{Path(folder, name)}: a link to a folder; put the folder itself there" for name in linked)
        yield from (Path(folder, name).relative_to(root).as_posix() for name in files)


def _is_wanted(name: str, found: list[str]) -> bool:
    """Tell ground truth from what lies beside it (`getFiles` passes over results, too) and from what looks like it."""
    base = PurePosixPath(name).name
    if base == "results.json" or base.startswith("._") or name.endswith("/"):
        return False
    if base.endswith(".json"):
        return True
    if base.lower().endswith(".json") or "gtbbox3d" in base.lower():
        found.append(f"{name}: name it <city>_<sequence>_<frame>_gtBbox3d.json, in this spelling, or remove it")
    return False


def _decode(file_name: str, data: bytes, found: list[str]) -> ground_truth_json.Document:
    try:
        document = ground_truth_json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        found.append(f"{file_name}: {error}")
        return _EMPTY
    found.extend(f"{file_name}: {problem}" for problem in ground_truth_json.problems(document))
    return document


_EMPTY = ground_truth_json.Document(
    sensor=ground_truth_json.Sensor(1, 1, 0, 0, ((0, 0, 0, 0), (0, 0, 0, 0), (0, 0, 0, 0))), objects=[], ignore=[]
)
"""Stands in for a file that does not decode, while the rest is checked."""


def _message(found: list[str]) -> str:
    listed = "\n".join(f"  {problem}" for problem in found[:_LISTED_PROBLEMS])
    rest = len(found) - _LISTED_PROBLEMS
    count = "1 problem" if len(found) == 1 else f"{len(found)} problems"
    return f"The ground truth has {count}:\n{listed}" + (f"\n  and {rest} more" if rest > 0 else "")


def _assemble(documents: dict[str, ground_truth_json.Document]) -> GroundTruth:
    objects = [(index, item) for index, file in enumerate(documents.values()) for item in file.objects]
    regions = [(index, item) for index, file in enumerate(documents.values()) for item in file.ignore]
    labels = sorted({item.label for _, item in objects})
    prototypes = sorted({item.box_3d.type for _, item in objects if item.box_3d.type is not None})
    boxes_2d = [item.box_2d.amodal_and_modal() for _, item in objects]
    sensors = [file.sensor for file in documents.values()]
    return GroundTruth(
        images=tuple(documents),
        labels=tuple(labels),
        prototypes=tuple(prototypes),
        intrinsics_px=_rows([(s.fx, s.fy, s.u0, s.v0) for s in sensors], 4),
        sensor_from_vehicle=_rows([chain(*s.sensor_T_ISO_8855) for s in sensors], 3, 4),
        image_index=_indices([index for index, _ in objects]),
        label_index=_positions(labels, [item.label for _, item in objects]),
        prototype_index=_positions(prototypes, [item.box_3d.type for _, item in objects]),
        center_m=_rows([item.box_3d.center for _, item in objects], 3),
        dimensions_m=_rows([item.box_3d.dimensions for _, item in objects], 3),
        rotation=_rows([item.box_3d.rotation for _, item in objects], 4),
        amodal_px=_rows([box[0] for box in boxes_2d if box], 4),
        modal_px=_rows([box[1] for box in boxes_2d if box], 4),
        occlusion=np.array([_or_nan(item.occlusion) for _, item in objects]),
        truncation=np.array([_or_nan(item.truncation) for _, item in objects]),
        ignore_image_index=_indices([index for index, _ in regions]),
        ignore_px=_rows([item.box_2d for _, item in regions], 4),
    )


def _positions(names: list[str], values: list[str | None] | list[str]) -> IndexArray:
    """Return the position of each value among the names, -1 for None."""
    position = {name: index for index, name in enumerate(names)}
    return _indices([-1 if value is None else position[value] for value in values])


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def _indices(values: list[int]) -> IndexArray:
    return np.array(values, dtype=np.int32)


def _rows(values: Iterable[Iterable[float]], *shape: int) -> Float64Array:
    """Return an array of rows of this shape; four times as fast as `numpy.array` on a list of tuples."""
    return np.fromiter(chain.from_iterable(values), dtype=np.float64).reshape(-1, *shape)
