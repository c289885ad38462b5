"""The pages over the same small installation as the API's tests."""

from tests.integration.api.conftest import archive, quiet_services, sandbox, score, site

__all__ = ["archive", "quiet_services", "sandbox", "score", "site"]
