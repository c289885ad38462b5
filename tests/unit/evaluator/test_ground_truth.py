"""Reading ground truth from folders and zips, storing it, and refusing what cannot be used."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluator.array_file import ArrayFileError, pack, unpack
from evaluator.ground_truth import GroundTruth, GroundTruthError, image_name, read_ground_truth
from evaluator.statistics import Statistics

CASE = Path(__file__).parents[2] / "data" / "oracle" / "realistic60" / "gt"
NAME = "bonn_000000_000019_gtBbox3d.json"


def _document() -> dict[str, Any]:
    camera = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]
    box = {"center": [10, 0, 1], "dimensions": [4, 2, 1], "rotation": [1, 0, 0, 0], "type": "Sedan"}
    return {
        "sensor": {"fx": 1000, "fy": 1000, "u0": 1024, "v0": 512, "sensor_T_ISO_8855": camera},
        "objects": [{"2d": {"amodal": [1, 2, 3, 4]}, "3d": box, "label": "car", "occlusion": 0.25}],
        "ignore": [{"2d": [5, 6, 7, 8]}],
    }


def _read(folder: Path, document: Any, name: str = NAME) -> GroundTruth:
    (folder / name).write_text(json.dumps(document))
    return read_ground_truth(folder)


def test_a_file_becomes_arrays(tmp_path: Path) -> None:
    """Every number stands where it should; a missing modal box is the amodal one, missing truncation NaN."""
    found = _read(tmp_path, _document())

    assert (found.images, found.labels, found.prototypes) == (("bonn_000000_000019",), ("car",), ("Sedan",))
    assert found.intrinsics_px.tolist() == [[1000, 1000, 1024, 512]]
    assert found.center_m.tolist() == [[10, 0, 1]]
    assert found.modal_px.tolist() == found.amodal_px.tolist() == [[1, 2, 3, 4]]
    assert found.ignore_px.tolist() == [[5, 6, 7, 8]]
    assert found.occlusion.tolist() == [0.25]
    assert np.isnan(found.truncation).all()


def test_citypersons_keys_go_first(tmp_path: Path) -> None:
    """`bbox` with `bboxVis` replaces both boxes, as in the reference."""
    document = _document()
    document["objects"][0]["2d"] |= {"bbox": [9, 9, 9, 9], "bboxVis": [8, 8, 8, 8]}

    found = _read(tmp_path, document)

    assert (found.amodal_px.tolist(), found.modal_px.tolist()) == ([[9, 9, 9, 9]], [[8, 8, 8, 8]])


def test_a_damaged_zip_is_refused(tmp_path: Path) -> None:
    """A member whose bytes are not what the archive says is an error of the ground truth that names the zip."""
    path = tmp_path / "gt.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(NAME, json.dumps(_document()))
    # The document starts behind the 30 bytes of the header and the name; its checksum no longer fits.
    start = 30 + len(NAME)
    data = path.read_bytes()
    path.write_bytes(data[:start] + b"[" + data[start + 1 :])

    with pytest.raises(GroundTruthError, match=r"gt\.zip cannot be read .*; pack it again"):
        read_ground_truth(path)


def test_a_zip_and_its_folder_are_equal(tmp_path: Path) -> None:
    """Sub folders, other suffixes and results.json beside the files make no difference."""
    path = tmp_path / "gt.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(CASE.iterdir(), reverse=True):
            archive.write(file, f"val/{file.name.split('_')[0]}/{file.name.replace('gtBbox3d', 'truth')}")
        archive.writestr("val/results.json", "{}")

    assert read_ground_truth(path).to_bytes() == read_ground_truth(CASE).to_bytes()


def test_storing_is_deterministic_and_loses_nothing() -> None:
    """Equal ground truth gives equal bytes, which read back to the same arrays."""
    found = read_ground_truth(CASE)

    again = GroundTruth.from_bytes(found.to_bytes())

    assert again.to_bytes() == found.to_bytes()
    assert again.images == found.images
    assert np.array_equal(again.rotation, found.rotation)


def test_the_image_list_holds_names_and_cameras_only() -> None:
    """What participants may know."""
    found = read_ground_truth(CASE)

    public = found.image_list()

    assert public.images == found.images
    assert np.array_equal(np.array(public.sensor_from_vehicle), found.sensor_from_vehicle)
    assert set(public.__struct_fields__) == {"images", "intrinsics_px", "sensor_from_vehicle"}


@pytest.mark.parametrize(
    ("file_name", "image"),
    [
        ("val/bonn/bonn_000000_000019_gtBbox3d.json", "bonn_000000_000019"),
        ("bonn_000000_000019_x.json", "bonn_000000_000019"),
        ("bonn_000000_000019.json", "bonn_000000"),
        ("bonn.json", None),
        ("_x.json", None),
    ],
)
def test_an_image_is_named_by_what_precedes_the_last_underscore(file_name: str, image: str | None) -> None:
    """Any suffix and folder; a name without underscore names no image."""
    assert image_name(file_name) == image


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("sensor"), "missing required field `sensor`"),
        (lambda d: d["objects"][0].pop("3d"), "missing required field `3d`"),
        (lambda d: d["objects"][0]["3d"].update(center=[1, 2]), r"\$.objects\[0\].3d.center"),
        (lambda d: d["objects"][0]["3d"].update(dimensions=[1, 0, 1]), "/objects/0/3d/dimensions"),
        (lambda d: d["objects"][0]["3d"].update(center=[1e30, 0, 0]), "/objects/0/3d/center.* within 10000 metres"),
        (lambda d: d["objects"][0]["3d"].update(rotation=[0, 0, 0, 0]), "/objects/0/3d/rotation"),
        (lambda d: d["objects"][0]["3d"].update(rotation=[1e-200, 0, 0, 0]), "/objects/0/3d/rotation.* 1e-200"),
        (lambda d: d["objects"][0]["3d"].update(rotation=[1e200, 0, 0, 0]), "/objects/0/3d/rotation.* 1e\\+200"),
        (lambda d: d["objects"][0]["2d"].pop("amodal"), "/objects/0/2d"),
        (lambda d: d["sensor"].update(fx=0), "/sensor"),
    ],
)
def test_what_cannot_be_used_is_refused_with_its_place(change: Any, message: str, tmp_path: Path) -> None:
    """The message names the file and where in it."""
    document = _document()
    change(document)

    with pytest.raises(GroundTruthError, match=message) as error:
        _read(tmp_path, document)

    assert NAME in str(error.value)


def test_all_problems_of_all_files_are_listed(tmp_path: Path) -> None:
    """Two broken files, a second file for an image and a name without image: four problems."""
    (tmp_path / "a_1_2_x.json").write_text("{")
    (tmp_path / "b_1_2_x.json").write_bytes(b'{"sensor": "\xff"}')
    (tmp_path / "nameless.json").write_text("{}")
    (tmp_path / "bonn_000000_000019_other.json").write_text(json.dumps(_document()))

    with pytest.raises(GroundTruthError, match="4 problems") as error:
        _read(tmp_path, _document())

    assert "a second file for image bonn_000000_000019" in str(error.value)


def test_an_empty_folder_or_another_file_is_refused(tmp_path: Path) -> None:
    """The message says what was looked for."""
    with pytest.raises(GroundTruthError, match="files in there"):
        read_ground_truth(tmp_path)
    (tmp_path / "x.txt").write_text("x")
    with pytest.raises(GroundTruthError, match="neither a folder nor a zip"):
        read_ground_truth(tmp_path / "x.txt")


def test_array_files_keep_values_types_and_shapes() -> None:
    """Empty arrays, several dimensions and big-endian input included."""
    arrays = {"a": np.zeros((0, 3)), "b": np.arange(6, dtype=">i4").reshape(2, 3), "c": np.array([True, False])}

    facts, found = unpack(pack({"x": [1, "y"]}, arrays))

    assert facts == {"x": [1, "y"]}
    assert {name: array.tolist() for name, array in found.items()} == {
        "a": [],
        "b": [[0, 1, 2], [3, 4, 5]],
        "c": [True, False],
    }
    assert (found["a"].shape, found["b"].dtype) == ((0, 3), np.dtype("<i4"))


def test_broken_array_files_are_refused() -> None:
    """Cut short, too long, something else, or holding objects: never a wrong array."""
    data = pack({}, {"a": np.arange(10.0)})

    for broken in (b"", b"PK", data[:-8], data + b"x", data.replace(b"<f8", b"|O8"), data[:30]):
        with pytest.raises(ArrayFileError):
            unpack(broken)
    with pytest.raises(TypeError, match="cannot be stored"):
        pack({}, {"a": np.array([None])})


def test_array_files_of_another_kind_are_refused() -> None:
    """Ground truth is no statistics, and the other way round."""
    data = read_ground_truth(CASE).to_bytes()

    with pytest.raises(ArrayFileError, match="statistics"):
        Statistics.from_bytes(data)
    with pytest.raises(ArrayFileError, match="ground truth"):
        GroundTruth.from_bytes(pack({}, {}))
