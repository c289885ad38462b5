"""Fixtures that every test may use."""

from tests.services.fixtures import (
    broker,
    bucket_server,
    installation,
    mail_sink,
    migrated_template,
    postgresql,
    services,
    shape,
    shape_settings,
)

__all__ = [
    "broker",
    "bucket_server",
    "installation",
    "mail_sink",
    "migrated_template",
    "postgresql",
    "services",
    "shape",
    "shape_settings",
]
