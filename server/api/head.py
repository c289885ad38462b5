"""HEAD: the headers GET would send, and no body (RFC 9110, section 9.3.2); as plain ASGI, for every address at once.

Servers leave the body of an answer to HEAD out; ending it at once also ends a stream that would go on for minutes.
"""

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class AnswersHead:
    """Hands HEAD on as GET; addresses below `own` answer it themselves."""

    def __init__(self, app: ASGIApp, own: str) -> None:
        """Wrap `app`."""
        self._app = app
        self._own = own

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; of an answer to HEAD only the head is sent."""
        if scope["type"] != "http" or scope["method"] != "HEAD" or scope["path"].startswith(self._own):
            await self._app(scope, receive, send)
            return

        async def send_head(message: Message) -> None:
            if message["type"] == "http.response.start":
                await send(message)
                await send({"type": "http.response.body", "body": b"", "more_body": False})

        await self._app({**scope, "method": "GET"}, receive, send_head)
