"""Public reading: benchmarks, their images, leaderboards (JSON and CSV)."""

import csv
import hashlib
import io
from typing import Annotated, Literal

import msgspec
from fastapi import APIRouter, Path, Query
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response

from server import benchmarks, ranking
from server.api import documents, errors, examples, rendering
from server.api.edge import Asker, WebDependency, answers, document_answer, not_modified, read
from server.api.identity import Identity
from server.errors import NotAuthenticated, NotFound, PhaseClosed

router = APIRouter(tags=["leaderboards"])

Slug = Annotated[str, Path(max_length=64)]

_MEANS = ("mds", "map", "mbevcd", "myaw_sim", "mpr_sim", "msize_sim")
_STANDING = ("mds_lower", "mds_upper", "rank_best", "rank_worst", "groups")
_ROW = ("rank", "method", "method_name", "team", "team_name", "submission_id", "created_at", "signature")

_NOT_MODIFIED = {"description": "Nothing changed since the version in If-None-Match."}


_RANKED = document_answer(
    "Published methods, best mDS first.",
    documents.LeaderboardDocument,
    example=examples.LEADERBOARD,
    headers={"ETag": "Version"},
)
_RANKED["content"]["text/csv"] = {"schema": {"type": "string"}}


@router.get(
    "/benchmarks",
    summary="Benchmarks and their phases",
    responses=answers(
        NotAuthenticated,
        errors.TooManyRequests,
        s200=document_answer("All benchmarks.", documents.BenchmarkList, example=examples.BENCHMARKS),
        s304=_NOT_MODIFIED,
    ),
)
def list_benchmarks(request: Request, web: WebDependency, asker: Asker) -> Response:
    """List every benchmark."""

    def work(session: Session, identity: Identity | None) -> Response:
        del identity
        rows = [rendering.benchmark_document(one) for one in benchmarks.list_benchmarks(session)]
        body = msgspec.json.encode(documents.BenchmarkList(benchmarks=rows))
        return _public(request, body, "application/json")

    return read(web, asker, work)


@router.get(
    "/benchmarks/{benchmark}/{phase}/images",
    summary="The images of a phase with their cameras",
    responses=answers(
        NotAuthenticated,
        errors.TooManyRequests,
        NotFound,
        PhaseClosed,
        errors.ValidationFailed,
        s200=document_answer(
            "What `cs3d validate --images` takes.", documents.ImagesDocument, headers={"ETag": "Version"}
        ),
        s304=_NOT_MODIFIED,
    ),
)
def show_images(request: Request, benchmark: Slug, phase: Slug, web: WebDependency, asker: Asker) -> Response:
    """List the images that need a prediction file: all of the ground truth that is public in a hidden phase."""

    def work(session: Session, identity: Identity | None) -> Response:
        del identity
        found = benchmarks.find_phase(session, benchmark, phase)
        if found.ground_truth is None:
            raise PhaseClosed(f"phase {phase} has no images yet: its ground truth is not imported")
        sha256 = found.ground_truth.image_list_sha256
        # The blob's name is its version: who holds it already is answered without reading it.
        if unchanged := not_modified(request, _etag(sha256)):
            return unchanged
        name = f"{found.benchmark.slug}-{found.slug}-images.json"
        return _public(request, web.services.blobs.read(sha256), "application/json", file_name=name)

    return read(web, asker, work)


@router.get(
    "/leaderboards/{benchmark}/{phase}",
    summary="The ranking of a phase",
    responses=answers(
        NotAuthenticated,
        errors.TooManyRequests,
        NotFound,
        errors.ValidationFailed,
        s200=_RANKED,
        s304=_NOT_MODIFIED,
    ),
)
def show_leaderboard(
    *,
    request: Request,
    benchmark: Slug,
    phase: Slug,
    web: WebDependency,
    asker: Asker,
    wanted: Annotated[Literal["json", "csv"] | None, Query(alias="format")] = None,
) -> Response:
    """Rank the published methods; CSV by `?format=csv` or `Accept: text/csv`."""
    as_csv = wanted == "csv" or (wanted is None and "text/csv" in request.headers.get("accept", ""))

    def work(session: Session, identity: Identity | None) -> Response:
        del identity
        board = ranking.leaderboard(session, benchmarks.find_phase(session, benchmark, phase))
        document = rendering.leaderboard_document(board, web.standings.of(session, board.rows))
        if as_csv:
            name = f"{board.phase.benchmark.slug}-{board.phase.slug}.csv"
            return _public(request, csv_of(document), "text/csv", file_name=name)
        return _public(request, msgspec.json.encode(document), "application/json")

    return read(web, asker, work)


def csv_of(document: documents.LeaderboardDocument) -> bytes:
    """Write a ranking as CSV: one row a method, undefined values empty, numbers in full precision."""
    labels = list(document.rows[0].classes) if document.rows else []
    metrics = documents.ClassSummary.__struct_fields__
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow([*_ROW, *_MEANS, *(f"{label}_{metric}" for label in labels for metric in metrics), *_STANDING])
    for row in document.rows:
        facts = [_inert(_written(value)) for value in map(row.__getattribute__, _ROW)]
        means = [row.__getattribute__(name) for name in _MEANS]
        classes = [getattr(row.classes[label], metric) for label in labels for metric in metrics]
        standing = [*(row.mds_interval or ("", "")), *(row.rank_interval or ("", "")), " ".join(row.groups)]
        writer.writerow([*facts, *means, *classes, *standing])
    return text.getvalue().encode()


def _written(value: object) -> str:
    """Write a fact as JSON does, times included; undefined is empty."""
    return "" if value is None else str(msgspec.to_builtins(value))


def _inert(text: str) -> str:
    """Keep a spreadsheet from taking a name for a formula (OWASP, CSV injection)."""
    return f"'{text}" if text[:1] in ("=", "+", "-", "@", "\t", "\r") else text


def _public(request: Request, body: bytes, media_type: str, *, file_name: str | None = None) -> Response:
    etag = _etag(hashlib.sha256(body).hexdigest())
    headers = {"ETag": etag, "Cache-Control": "public, no-cache", "Vary": "Accept"}
    if file_name:
        headers["Content-Disposition"] = f'attachment; filename="{file_name}"'
    return not_modified(request, etag) or Response(body, headers=headers, media_type=media_type)


def _etag(sha256: str) -> str:
    return f'"{sha256[:32]}"'
