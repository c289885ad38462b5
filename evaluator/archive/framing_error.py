"""What stops the reading of a zip's framing at once."""

from evaluator.codes import Code


class FramingError(Exception):
    """The archive as a whole cannot be read. Never leaves this package: it becomes an entry of the report."""

    def __init__(self, code: Code, detail: str) -> None:
        """Remember what to report."""
        super().__init__(detail)
        self.code = code
        self.detail = detail
