"""Our application in an installation whose framing check takes archives as large as its setting allows."""

import functools

import msgspec
from fastapi import FastAPI

from evaluator.intake import check_archive
from evaluator.limits import DEFAULT_LIMITS
from server.api import receiving
from server.services import Services
from server.settings import Settings
from server.web import create_app


def application() -> FastAPI:
    """Make the application from the environment, with the cap on archives raised to the cap on uploads."""
    settings = Settings()
    limits = msgspec.structs.replace(DEFAULT_LIMITS, archive_bytes=settings.upload_max_bytes)
    receiving.check_archive = functools.partial(check_archive, limits=limits)  # type: ignore[attr-defined]
    return create_app(Services.from_settings(settings))
