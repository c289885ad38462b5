"""What a sender wants done with an archive: said in the query or in a form, under the same limits."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel, Field, ValidationError

from server.accounts import MAX_URL_CHARACTERS
from server.api.errors import InvalidValue, ValidationFailed
from server.submissions import Shown

MAX_TEXT_CHARACTERS = 200
MAX_DESCRIPTION_CHARACTERS = 10_000

REQUIRED = ("benchmark", "phase", "method")

Text = Annotated[str | None, Field(max_length=MAX_TEXT_CHARACTERS)]
Url = Annotated[str | None, Field(max_length=MAX_URL_CHARACTERS)]


class OrderFields(BaseModel):
    """What is to be done with an archive, as its sender says it: in the query, or in the fields of a form."""

    benchmark: Text = None
    phase: Text = None
    method: Text = None
    method_name: Text = None
    description: Annotated[str, Field(max_length=MAX_DESCRIPTION_CHARACTERS)] = ""
    paper_url: Url = None
    code_url: Url = None
    file_name: Text = None
    team: Text = None

    @classmethod
    def of_form(cls, values: Mapping[str, str]) -> "OrderFields":
        """Read the fields of a form; others are not looked at.

        Raises:
            ValidationFailed: They hold what they may not.
        """
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            wrong = (InvalidValue("/".join(("body", *map(str, one["loc"]))), one["msg"]) for one in error.errors())
            raise ValidationFailed(tuple(wrong)) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What the sender wants done with the archive."""

    benchmark: str
    phase: str
    method: str
    shown: Shown
    file_name: str = "predictions.zip"
    team: str | None = None
    """Slug; needed by users of several teams who send without a token."""
    idempotency_key: str | None = None


def order_of(fields: OrderFields, idempotency_key: str | None = None, *, file_name: str | None = None) -> Order:
    """Make an order of the fields of a request.

    Args:
        fields: As they were given.
        idempotency_key: As it was given.
        file_name: What the archive is called where the fields do not say it.

    Raises:
        ValidationFailed: Fields are missing.
    """
    missing = [InvalidValue(name, "is missing") for name in REQUIRED if not getattr(fields, name)]
    if missing:
        raise ValidationFailed(tuple(missing))
    return Order(
        benchmark=fields.benchmark or "",
        phase=fields.phase or "",
        method=fields.method or "",
        shown=Shown(
            name=fields.method_name or "",
            description=fields.description,
            paper_url=fields.paper_url or "",
            code_url=fields.code_url or "",
        ),
        file_name=fields.file_name or file_name or "predictions.zip",
        team=fields.team or None,
        idempotency_key=idempotency_key,
    )
