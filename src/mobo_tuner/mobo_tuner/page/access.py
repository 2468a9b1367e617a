"""Who may read the page and who may act: one origin, a token, and what the browser is allowed to load."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mobo_tuner.addresses import is_local

LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
POLICY = "; ".join(
    (
        "default-src 'self'",
        # The framework compiles its templates in the browser; no script comes from anywhere else.
        "script-src 'self' 'unsafe-inline' 'unsafe-eval'",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data:",
        "font-src 'self' data:",
        "connect-src 'self'",
        "object-src 'none'",
        "base-uri 'self'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "permissions-policy": "camera=(), microphone=(), geolocation=()",
}


class Access:
    """Rules of access to one page.

    Args:
        host: Address that the page listens on.
        read_only: Whether nobody may act.
        token: Token of those who may act, beyond this host; empty to make one.

    Attributes:
        local: Whether the page listens on this host alone.
        token: Token of those who may act; empty if none is needed, or nobody may.
    """

    def __init__(self, host: str, *, read_only: bool, token: str = "") -> None:
        self.local = is_local(host)
        self._read_only = read_only
        self.token = "" if self.local or read_only else token or secrets.token_urlsafe(24)

    def may_act(self, headers: Mapping[str, str], port: int) -> bool:
        """Return whether a request comes from somebody who may act.

        Args:
            headers: Headers of the request.
            port: Port of the page, by which the cookies of several pages differ.
        """
        if self._read_only:
            return False
        if not self.token:
            return True
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return False
        given = cookies.get(cookie_name(port))
        return given is not None and self.is_token(given.value)

    def is_token(self, text: str) -> bool:
        """Return whether a text is the token."""
        return bool(self.token) and hmac.compare_digest(text.encode(), self.token.encode())

    def refusal(self, headers: Mapping[str, str]) -> str:
        """Return why a request is refused, in one sentence; empty if it is served.

        A page of this host alone is served under this host's names alone, so that no name of another
        site can be made to lead here. A request from the page of another origin is refused.

        Args:
            headers: Headers of the request.
        """
        host = headers.get("host", "")
        if self.local and _name_of(f"//{host}") not in LOCAL_NAMES:
            return f"the host is {host!r}; {', '.join(LOCAL_NAMES)} are allowed"
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return f"the origin is {origin!r}; that of this page is allowed"
        return ""


class Guard:
    """Applies the rules of access to every request and every connection.

    Args:
        app: Application behind it.
        access: Rules of access.
        port: Port of the page.
    """

    def __init__(self, app: ASGIApp, access: Access, port: int) -> None:
        self.app = app
        self._access = access
        self._port = port

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        refusal = self._access.refusal(Headers(scope=scope))
        if scope["type"] == "websocket":
            if refusal:
                await receive()
                await send({"type": "websocket.close", "code": 1008, "reason": refusal[:100]})
                return
            await self.app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
            await send(message)

        answer: ASGIApp = self.app
        if refusal:
            answer = PlainTextResponse(refusal, status_code=403)
        elif given := parse_qs(scope["query_string"].decode("latin-1")).get("token"):
            answer = self._admit(given[0])
        await answer(scope, receive, send_with_headers)

    def _admit(self, token: str) -> Response:
        """Answer to an address with a token: keep it as a cookie, out of the address."""
        if self._access.token and not self._access.is_token(token):
            return PlainTextResponse("the token is not that of this page", status_code=403)
        answer = RedirectResponse("/", status_code=303)
        if self._access.token:
            answer.set_cookie(
                cookie_name(self._port), token, httponly=True, samesite="lax", path="/"
            )
        return answer


def cookie_name(port: int) -> str:
    """Return the name of the cookie of the page on a port."""
    return f"mobo_page_{port}"


def _name_of(address: str) -> str:
    """Return the host's name in an address; empty if it has none."""
    try:
        return (urlsplit(address).hostname or "").lower()
    except ValueError:
        return ""
