"""Query parameters that an address of the API does not have are refused: a misspelt one would be lost without a word."""

import difflib
import itertools
from collections import Counter
from collections.abc import Iterator

from fastapi.dependencies.models import Dependant
from pydantic import BaseModel
from starlette.requests import Request

from server.api.errors import InvalidValue, ValidationFailed

_MOST_SAID = 10
"""So many wrong parameters are named, so that a long query does not get an answer many times its length."""
_SHOWN_CHARACTERS = 64


async def check_parameters(request: Request) -> None:
    """Refuse parameters that the matched route does not read, and those that come twice: none of ours is a list.

    For the API alone: pages take every parameter, for links to them come from anywhere.

    Raises:
        ValidationFailed: It names them, and what there is instead.
    """
    given = Counter(name for name, _ in request.query_params.multi_items())
    if not given:
        return
    known = list(dict.fromkeys(_names(request.scope["route"].dependant)))
    wrong = tuple(itertools.islice(_wrong(given, known), _MOST_SAID))
    if wrong:
        raise ValidationFailed(wrong)


def _names(dependant: Dependant) -> Iterator[str]:
    """Give the query parameters that an endpoint and what it depends on read."""
    for field in dependant.query_params:
        model = field.field_info.annotation
        if isinstance(model, type) and issubclass(model, BaseModel):
            yield from model.model_fields
        else:
            yield field.alias
    for inner in dependant.dependencies:
        yield from _names(inner)


def _wrong(given: Counter[str], known: list[str]) -> Iterator[InvalidValue]:
    for name, times in given.items():
        if name not in known:
            yield InvalidValue(f"query/{name[:_SHOWN_CHARACTERS]}", _instead(name[:_SHOWN_CHARACTERS], known))
        elif times > 1:
            yield InvalidValue(f"query/{name}", f"is given {times} times; give it once")


def _instead(name: str, known: list[str]) -> str:
    if not known:
        return "there are no query parameters here"
    nearest = difflib.get_close_matches(name.lower(), known, n=1)
    meant = f"did you mean {nearest[0]}? " if nearest else ""
    return f"there is no such parameter; {meant}known: {', '.join(known)}"
