"""Hypothesis over the schema of predictions: documents that are nearly right, in every way."""

import json
from datetime import timedelta
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from evaluator.protocol import VEHICLE_LABELS
from tests.fuzz.agreement import check_document

EXAMPLES = 400

_NUMBERS = st.one_of(
    st.sampled_from([0, 1, -1, 0.5, 0.01, 0.0099, 100, 100.5, 10_000, 10_001, -0.0, 1e-320, 1e308, 10**25, 1e6, 1e7]),
    st.floats(width=64),
    st.integers(-(10**30), 10**30),
    st.floats(0, 1),
)
_ODD = st.one_of(st.none(), st.booleans(), st.text(max_size=5), st.just([]), st.just({}), _NUMBERS)


def _numbers(count: int, good: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Mostly a right array of numbers."""
    right = st.lists(good, min_size=count, max_size=count)
    return st.one_of(
        right, right, right, st.lists(_NUMBERS, min_size=count, max_size=count), st.lists(_ODD, max_size=6), _ODD
    )


def _object(fields: dict[str, st.SearchStrategy[Any]]) -> st.SearchStrategy[Any]:
    """Mostly an object with all its fields."""
    whole = st.fixed_dictionaries(fields)
    extra = st.dictionaries(
        st.one_of(st.sampled_from([*fields, "bbox", "bboxVis", "a:b"]), st.text(max_size=3)), _ODD, max_size=2
    )
    mixed = st.builds(lambda one, two: {**two, **one}, whole, extra)
    return st.one_of(whole, whole, mixed, st.fixed_dictionaries({}, optional=fields), _ODD)


_SIZES = st.floats(0.01, 100)
_RECTANGLE = _numbers(4, st.floats(0, 2048))
_BOX = _object(
    {
        "label": st.one_of(st.sampled_from(VEHICLE_LABELS), st.sampled_from(VEHICLE_LABELS), _ODD),
        "score": st.one_of(st.floats(0, 1), _ODD),
        "2d": st.one_of(_object({"amodal": _RECTANGLE}), _object({"amodal": _RECTANGLE, "modal": _RECTANGLE})),
        "3d": _object(
            {
                "center": _numbers(3, st.floats(-100, 100)),
                "dimensions": _numbers(3, _SIZES),
                "rotation": _numbers(4, st.sampled_from([0.5, -0.5])),
            }
        ),
    }
)
DOCUMENTS = _object({"objects": st.one_of(st.lists(_BOX, max_size=4), _ODD)})


@settings(
    max_examples=EXAMPLES,
    deadline=timedelta(seconds=5),
    suppress_health_check=list(HealthCheck),
    phases=(Phase.explicit, Phase.generate, Phase.shrink),
)
@given(document=DOCUMENTS, indent=st.sampled_from([None, 1]), ascii_only=st.booleans())
def test_both_paths_agree_on_documents(document: object, indent: int | None, *, ascii_only: bool) -> None:
    """Whatever a document of roughly the right shape holds, the fast and the slow path agree on it."""
    text = json.dumps(document, indent=indent, ensure_ascii=ascii_only)
    check_document(text.encode("utf-8", "surrogatepass"))


@settings(max_examples=EXAMPLES, deadline=timedelta(seconds=5), suppress_health_check=list(HealthCheck))
@given(document=DOCUMENTS, data=st.data())
def test_both_paths_agree_on_damaged_text(document: object, data: st.DataObject) -> None:
    """The same after bytes of the text were removed, doubled or replaced: keys stand twice, brackets miss."""
    text = json.dumps(document).encode()
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 40)))
    other = data.draw(st.one_of(st.just(b""), st.just(text[start:end] * 2), st.just(b","), st.binary(max_size=4)))
    check_document(text[:start] + other + text[end:])
