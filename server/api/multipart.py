"""multipart/form-data with one large file, parsed while it arrives (RFC 7578).

The file part goes straight to the spool; the other fields are small and kept in memory under caps. Whatever is neither
(boundaries, headers, what stands after the closing boundary) counts against one cap together with them.
"""

from collections.abc import AsyncIterator, Collection, Mapping
from dataclasses import dataclass, field

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from server.api.errors import InvalidValue, MalformedRequest, UnsupportedMediaType, ValidationFailed
from server.api.spool import FORM_OVERHEAD_BYTES, Spool

MAX_PARTS = 24
MAX_FIELD_BYTES = 64 << 10
_SHOWN_CHARACTERS = 64


@dataclass(slots=True)
class Form:
    """A parsed form."""

    fields: dict[str, str] = field(default_factory=dict)
    file_name: str | None = None
    """As the sender named the file part; None when there was none."""


@dataclass(slots=True)
class _Part:
    name: str
    file_name: str | None
    data: bytearray = field(default_factory=bytearray)


def boundary_of(content_type: str) -> bytes:
    """Read the boundary of a multipart/form-data content type.

    Raises:
        UnsupportedMediaType: It is another type.
        MalformedRequest: It names no boundary.
    """
    kind, options = parse_options_header(content_type)
    if kind != b"multipart/form-data":
        raise UnsupportedMediaType(f"Send multipart/form-data or application/zip, not {content_type!r}.")
    boundary = options.get(b"boundary", b"")
    if not boundary:
        raise MalformedRequest("The Content-Type multipart/form-data needs its boundary parameter.")
    return boundary


class FormReader:
    """Reads one form; the part named `file_field` is written to `spool`."""

    def __init__(self, boundary: bytes, spool: Spool, *, file_field: str, known: Collection[str]) -> None:
        """Begin a form.

        Args:
            boundary: What stands between its parts.
            spool: Where its file goes.
            file_field: Name of the part that is the file.
            known: Names of the other parts there may be.
        """
        self.form = Form()
        self._spool = spool
        self._file_field = file_field
        self._known = known
        self._header_name = bytearray()
        self._header_value = bytearray()
        self._headers: dict[str, str] = {}
        self._part: _Part | None = None
        self._file_bytes: list[bytes] = []
        self._names: set[str] = set()
        self._received_bytes = 0
        self._complete = False
        try:
            self._parser = MultipartParser(
                boundary,
                {
                    "on_part_begin": self._begin_part,
                    "on_header_field": self._add_header_name,
                    "on_header_value": self._add_header_value,
                    "on_header_end": self._end_header,
                    "on_headers_finished": self._open_part,
                    "on_part_data": self._add_data,
                    "on_part_end": self._end_part,
                    "on_end": self._end,
                },
            )
        except FormParserError as error:
            raise MalformedRequest(f"The form cannot be read: {error}.") from error

    async def read(self, stream: AsyncIterator[bytes]) -> Form:
        """Read the whole body.

        Raises:
            MalformedRequest: It is not a form, ends early, or breaks a cap.
            ValidationFailed: It has a part of another name than it may.
        """
        async for chunk in stream:
            await self.feed(chunk)
        return self.finish()

    def finish(self) -> Form:
        """Give the form once the body has ended.

        Raises:
            MalformedRequest: It ended early.
        """
        if not self._complete:
            raise MalformedRequest("The form ends before its closing boundary; send it again.")
        return self.form

    async def feed(self, chunk: bytes) -> Mapping[str, str]:
        """Parse the next bytes of the body and give the fields that are complete by now.

        Raises:
            MalformedRequest: It is not a form, or breaks a cap.
            ValidationFailed: It has a part of another name than it may.
            UploadTooLarge: The archive is larger than the server takes.
        """
        try:
            self._parser.write(chunk)
        except FormParserError as error:
            raise MalformedRequest(f"The form cannot be read: {error}.") from error
        for data in self._file_bytes:
            await self._spool.write(data)
        self._file_bytes.clear()
        self._received_bytes += len(chunk)
        if self._received_bytes - self._spool.size_bytes > FORM_OVERHEAD_BYTES:
            raise MalformedRequest(f"The form has more than {FORM_OVERHEAD_BYTES} bytes besides the archive.")
        return self.form.fields

    def _begin_part(self) -> None:
        self._headers = {}
        self._part = None

    def _add_header_name(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]

    def _add_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]

    def _end_header(self) -> None:
        self._headers[self._header_name.decode("latin-1").lower()] = self._header_value.decode("utf-8", "replace")
        self._header_name.clear()
        self._header_value.clear()

    def _open_part(self) -> None:
        _, options = parse_options_header(self._headers.get("content-disposition", "").encode())
        name = options.get(b"name", b"").decode("utf-8", "replace")
        file_name = options[b"filename"].decode("utf-8", "replace") if b"filename" in options else None
        if not name:
            raise MalformedRequest("A part of the form has no name; write `Content-Disposition: form-data; name=...`.")
        if name in self._names:
            raise MalformedRequest(f"The form has more than one part named {name!r}; send it once.")
        self._refuse_unknown(name)
        self._names.add(name)
        if len(self._names) > MAX_PARTS:
            raise MalformedRequest(f"The form has more than {MAX_PARTS} parts.")
        if name == self._file_field:
            self.form.file_name = file_name or ""
        self._part = _Part(name, file_name)

    def _refuse_unknown(self, name: str) -> None:
        if name == self._file_field or name in self._known:
            return
        there = f"the archive's part is called {self._file_field}, the other fields are {', '.join(self._known)}"
        raise ValidationFailed((InvalidValue(f"body/{name[:_SHOWN_CHARACTERS]}", f"there is no such field; {there}"),))

    def _add_data(self, data: bytes, start: int, end: int) -> None:
        part = self._part
        if part is None:
            return
        if part.name == self._file_field:
            self._file_bytes.append(data[start:end])
            return
        part.data += data[start:end]
        if len(part.data) > MAX_FIELD_BYTES:
            raise MalformedRequest(f"The form field {part.name!r} is longer than {MAX_FIELD_BYTES} bytes.")

    def _end_part(self) -> None:
        part = self._part
        if part is not None and part.name != self._file_field and part.file_name is None:
            self.form.fields[part.name] = part.data.decode("utf-8", "replace")

    def _end(self) -> None:
        self._complete = True
