"""How labels become numbers: each known one is decoded as a letter, which MessagePack writes in two bytes."""

import json
import tracemalloc

import numpy as np
import pytest

from evaluator.columns import ColumnBuilder
from evaluator.decoding import MOST_LABELS, box_decoder


def _document(*labels: object) -> bytes:
    boxes = [
        {
            "label": label,
            "score": number / 1000,
            "2d": {"amodal": [1.0, 2.0, 3.0, 4.0]},
            "3d": {"center": [1.0, 2.0, 3.0], "dimensions": [4.0, 2.0, 1.5], "rotation": [1.0, 0.0, 0.0, 0.0]},
        }
        for number, label in enumerate(labels)
    ]
    return json.dumps({"objects": boxes}).encode()


def _label_index(data: bytes, known_labels: tuple[str, ...]) -> list[int] | None:
    boxes = box_decoder(known_labels).decode(data)
    if boxes is None:
        return None
    builder = ColumnBuilder()
    builder.add(boxes)
    columns, _ = builder.build(np.zeros(len(boxes), dtype=np.int32))
    assert columns.score.tolist() == [number / 1000 for number in range(len(boxes))]
    return [int(number) for number in columns.label_index]


@pytest.mark.parametrize(
    "known_labels",
    [
        ("car", "a rather long label of a few words", "bus"),
        tuple(chr(MOST_LABELS - 1 - number) for number in range(MOST_LABELS)),  # letters that stand for other labels
        tuple(f"class {number}" for number in range(MOST_LABELS)),
        ("", "été", "\N{BUS}", "\x00"),
        ("name", "value", "_value_", "mro", "__class__", "label_0"),
    ],
)
def test_labels_are_numbered_as_they_stand(known_labels: tuple[str, ...]) -> None:
    """Whatever a label looks like, boxes get its place among the known ones."""
    order = [*range(len(known_labels)), 0, len(known_labels) - 1]

    assert _label_index(_document(*(known_labels[number] for number in order)), known_labels) == order


def test_an_escaped_label_is_the_same_label() -> None:
    """JSON may write any letter as an escape."""
    data = _document("car", "bus").replace(b'"bus"', rb'"b\u0075s"')

    assert _label_index(data, ("car", "bus")) == [0, 1]


@pytest.mark.parametrize("label", ["Car", "car ", "", "\x00", "\x01", "\x02", "label_0", "car?", "bus?"])
def test_unknown_labels_share_the_number_after_the_last(label: str) -> None:
    """Neither the letters nor the names inside of the known labels are labels; the other boxes of the file count."""
    assert _label_index(_document("car", label, "bus"), ("car", "bus")) == [0, 2, 1]


@pytest.mark.parametrize("label", [0, 1, None, True, ["car"], {"car": 0}])
def test_what_is_no_text_is_no_label(label: object) -> None:
    """Such files are explained."""
    assert _label_index(_document("car", label), ("car", "bus")) is None


def test_an_unknown_label_beside_as_many_as_there_may_be() -> None:
    """It has the last letter of ASCII, which MessagePack writes in two bytes, too."""
    known_labels = tuple(f"class {number}" for number in range(MOST_LABELS))

    assert _label_index(_document("class 126", "class 127", "class 0"), known_labels) == [126, 127, 0]


@pytest.mark.parametrize("strange", ["\udcff", "a label of many letters \udcff"])
def test_a_known_label_that_is_no_unicode_has_no_boxes(strange: str) -> None:
    """A command line that is no UTF-8 may give one; no file can have it, and the others keep their numbers."""
    known_labels = ("car", strange, "bus")

    assert _label_index(_document("bus", "van", "car"), known_labels) == [2, 3, 0]
    assert _label_index(_document("bus", strange), known_labels) is None


def test_an_unknown_label_is_not_quoted_in_memory() -> None:
    """An error message of msgspec would quote the whole label, four bytes for each letter and more."""
    label = "\x7f" * 1_000_000 + "\N{BUS}"
    data = json.dumps(
        {"objects": [{**json.loads(_document("car"))["objects"][0], "label": label}]}, ensure_ascii=False
    ).encode()
    decoder = box_decoder(("car", "bus"))
    tracemalloc.start()
    try:
        boxes = decoder.decode(data)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert boxes is not None
    assert boxes[0].label == "\x02"
    assert peak_bytes < 6 * len(label)
