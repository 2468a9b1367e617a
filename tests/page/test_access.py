"""Who may read and act: hosts, origins, tokens, and what is said to browsers."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any

import pytest
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from launcher.page import TOKEN_VARIABLE as LAUNCHERS_VARIABLE
from launcher.page import is_local as launcher_is_local
from mobo_tuner.addresses import is_local
from mobo_tuner.nodes.page import TOKEN_VARIABLE
from mobo_tuner.page.access import Access, Guard, cookie_name

PORT = 8070
TOKEN = "a-token"


@dataclass
class Answer:
    """What a browser gets."""

    status: int
    headers: dict[str, str]
    text: str


@dataclass
class Browser:
    """A browser of a page that says whether its reader may act; it keeps cookies."""

    access: Access
    host: str = f"127.0.0.1:{PORT}"
    cookies: dict[str, str] = field(default_factory=dict)

    def get(self, target: str, **headers: str) -> Answer:
        """Ask for the page."""
        messages = self._exchange("http", target, headers)
        start = messages[0]
        found = {name.decode(): value.decode() for name, value in start["headers"]}
        if "set-cookie" in found:
            name, _, value = found["set-cookie"].partition(";")[0].partition("=")
            self.cookies[name] = value
        text = b"".join(m.get("body", b"") for m in messages[1:]).decode()
        return Answer(start["status"], found, text)

    def connects(self, **headers: str) -> bool:
        """Ask for a websocket; whether it is opened."""
        return self._exchange("websocket", "/", headers)[0]["type"] == "websocket.accept"

    def _exchange(self, kind: str, target: str, headers: dict[str, str]) -> list[Any]:
        async def page(scope: Scope, receive: Receive, send: Send) -> None:
            if scope["type"] == "websocket":
                await send({"type": "websocket.accept"})
                return
            acts = self.access.may_act(Request(scope).headers, PORT)
            await PlainTextResponse("acts" if acts else "reads")(scope, receive, send)

        path, _, query = target.partition("?")
        cookies = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        given = {"host": self.host, "cookie": cookies, **headers}
        scope = {
            "type": kind,
            "method": "GET",
            "path": path,
            "query_string": query.encode(),
            "headers": [(name.encode(), value.encode()) for name, value in given.items()],
        }
        sent: list[Any] = []

        async def receive() -> Any:
            return {"type": f"{kind}.connect" if kind == "websocket" else "http.request"}

        async def send(message: Any) -> None:
            sent.append(message)

        asyncio.run(Guard(page, self.access, PORT)(scope, receive, send))
        return sent


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]", "LOCALHOST"])
def test_on_this_host_everybody_may_act(host: str) -> None:
    answer = Browser(Access("127.0.0.1", read_only=False), f"{host}:{PORT}").get("/")
    assert (answer.status, answer.text) == (200, "acts")


@pytest.mark.parametrize("host", ["rebound.example", "127.0.0.1.example", "10.0.0.7", "x" * 300])
def test_another_name_of_this_host_is_refused(host: str) -> None:
    answer = Browser(Access("127.0.0.1", read_only=False), f"{host}:{PORT}").get("/")
    assert answer.status == 403
    assert "127.0.0.1" in answer.text


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        (f"http://127.0.0.1:{PORT}", 200),
        ("http://127.0.0.1:9999", 403),
        ("http://evil.example", 403),
        ("null", 403),
    ],
)
def test_only_the_pages_own_origin_is_served(origin: str, status: int) -> None:
    browser = Browser(Access("127.0.0.1", read_only=False))
    assert browser.get("/", origin=origin).status == status
    assert browser.connects(origin=origin) == (status == 200)


def test_beyond_this_host_the_token_is_needed_to_act_and_becomes_a_cookie() -> None:
    access = Access("0.0.0.0", read_only=False, token=TOKEN)
    browser = Browser(access, f"control.example:{PORT}")
    assert browser.get("/").text == "reads"
    assert browser.get("/?token=another").status == 403
    admitted = browser.get(f"/?token={TOKEN}")
    assert (admitted.status, admitted.headers["location"]) == (303, "/")
    cookie = admitted.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=lax" in cookie
    assert browser.get("/").text == "acts"
    browser.cookies = {cookie_name(PORT): "another"}
    assert browser.get("/").text == "reads"


def test_each_page_beyond_this_host_has_a_token_of_its_own() -> None:
    tokens = {Access("0.0.0.0", read_only=False).token for _ in range(3)}
    assert len(tokens) == 3
    assert min(map(len, tokens)) >= 32
    assert Access("127.0.0.1", read_only=False, token=TOKEN).token == ""


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_nobody_may_act_on_a_page_that_is_read_only(host: str) -> None:
    access = Access(host, read_only=True, token=TOKEN)
    browser = Browser(access)
    browser.get(f"/?token={TOKEN}")
    assert browser.get("/").text == "reads"


def test_every_answer_tells_the_browser_to_load_nothing_from_elsewhere() -> None:
    browser = Browser(Access("127.0.0.1", read_only=False))
    for answer in (browser.get("/"), browser.get("/", origin="null")):
        policy = answer.headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert "http" not in policy
        assert answer.headers["x-frame-options"] == "DENY"
        assert answer.headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize(
    ("host", "local"),
    [
        ("127.0.0.1", True),
        ("127.1.2.3", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("::", False),
        ("control.example", False),
        ("10.0.0.7", False),
    ],
)
def test_entry_script_and_page_agree_on_what_is_this_host_alone(host: str, local: bool) -> None:
    assert is_local(host) == launcher_is_local(host) == local
    assert TOKEN_VARIABLE == LAUNCHERS_VARIABLE
