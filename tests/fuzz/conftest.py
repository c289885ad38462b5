"""The application of the API's tests, for fuzzing it."""

from tests.integration.api.conftest import archive, quiet_services, sandbox, score, site

__all__ = ["archive", "quiet_services", "sandbox", "score", "site"]
