"""The REST API under /api/v1: JSON answers, RFC 9457 problem documents, OpenAPI."""
