"""The web server of the page: its thread, its address, and the open pages that it refreshes."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import sys
import threading
import time
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from fastapi.middleware.gzip import GZipMiddleware
from nicegui import app, ui
from starlette.responses import PlainTextResponse, Response

from mobo_tuner.client import TunerClient
from mobo_tuner.errors import UserError
from mobo_tuner.page.access import Access, Guard
from mobo_tuner.page.board import Board
from mobo_tuner.page.commands import Commands, Turns
from mobo_tuner.page.feed import Feed
from mobo_tuner.page.history import History
from mobo_tuner.page.insights import Insights
from mobo_tuner.page.view import View
from mobo_tuner.page.words import first_words

REFRESH_PERIOD = 0.2  # [s]
RECONNECT_TIMEOUT = 10.0  # [s] sets how often a browser is asked whether it is there (.8), and its time to answer (.4)
KEEP_TIMEOUT = 45.0  # [s] for which a page is kept whose browser is busy or asleep
MAX_VIEWS = 40  # pages that are open at a time
STOP_TIMEOUT = 0.6  # [s] for the server to end
BACKLOG = 64
COMPRESSION = 1  # fast: the framework's files are large, and a browser keeps them
STATIC = Path(__file__).parent / "static"

_LOG = logging.getLogger(__name__)


class PageServer:
    """Serves the page on a thread of its own.

    Args:
        feed: Messages of the tuner and the other nodes.
        client: Client by which viewers ask the tuner.
        history: Runs of the folder.
        access: Rules of access.
        listener: Socket that listens for browsers.
    """

    def __init__(
        self,
        feed: Feed,
        client: TunerClient,
        history: History,
        access: Access,
        listener: socket.socket,
    ) -> None:
        self._feed = feed
        self._client = client
        self._history = history
        self._insights = Insights(history)
        self._access = access
        self._listener = listener
        self._port = int(listener.getsockname()[1])
        self._board = Board()
        self._views: list[View] = []
        config = uvicorn.Config(
            self._application(),
            log_level="critical",  # it complains at every end that browsers are still connected
            access_log=False,
            ws_max_size=2**20,
            timeout_graceful_shutdown=0,
            server_header=False,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._serve, name="page", daemon=True)
        self._thread.start()

    @property
    def failed(self) -> bool:
        """Whether the server has ended without being asked to."""
        return not self._thread.is_alive() and not self._server.should_exit

    def stop(self) -> None:
        """End the server; the browsers notice."""
        self._server.should_exit = self._server.force_exit = True

    def join(self) -> None:
        """Wait for the end of the server, but not for long."""
        self.stop()
        self._thread.join(STOP_TIMEOUT)

    def _serve(self) -> None:
        self._server.run(sockets=[self._listener])

    def _application(self) -> FastAPI:
        """Return the web application: the page, behind the rules of access."""
        application = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        application.add_middleware(Guard, access=self._access, port=self._port)
        app.add_static_files("/page", STATIC)
        turns = Turns()

        @ui.page("/", title="MOBO", dark=True, language="en-US", reconnect_timeout=KEEP_TIMEOUT)
        async def page(request: Request) -> Response | None:
            if len(self._views) >= MAX_VIEWS:
                return PlainTextResponse(f"{MAX_VIEWS} pages are open; close one", status_code=503)
            may_act = self._access.may_act(request.headers, self._port)
            ui.add_head_html('<link rel="stylesheet" href="/page/page.css">')
            ui.add_head_html('<script src="/page/page.js" defer></script>')
            dark = request.query_params.get("theme") != "light"
            ui.add_body_html(first_words(self._board, dark=dark))
            allowed = Commands(self._client, turns) if may_act else None
            view = View(self._board, allowed, self._history, self._insights, dark=dark)
            view.refresh()
            self._views.append(view)
            ui.context.client.on_delete(lambda: self._views.remove(view))
            return None

        async def begin() -> None:
            self._refresher = asyncio.create_task(self._refresh())

        app.on_startup(begin)
        ui.run_with(
            application,
            title="MOBO",
            favicon=STATIC / "favicon.svg",
            reconnect_timeout=RECONNECT_TIMEOUT,
            tailwind=False,
            binding_refresh_interval=None,
            gzip_middleware_factory=lambda app: GZipMiddleware(app, compresslevel=COMPRESSION),
            show_welcome_message=False,
        )
        return application

    async def _refresh(self) -> None:
        """Refresh all open pages, again and again."""
        while True:
            started = time.monotonic()
            try:
                self._feed.move_to(self._board)
            except Exception:
                _LOG.exception("a message could not be read")
            for view in [*self._views]:
                try:
                    view.refresh()
                except Exception:
                    _LOG.exception("a page could not be refreshed")
            spent = time.monotonic() - started
            await asyncio.sleep(max(REFRESH_PERIOD, 2.0 * spent))  # leaves time for the browsers


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens for browsers.

    If the process was started with a listening socket as its standard input, it is that one.

    Args:
        host: Address to listen on.
        port: Port; 0 = any free one.

    Raises:
        UserError: If nobody can listen there.
    """
    inherited = _inherited()
    if inherited is not None:
        return inherited
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listener = socket.socket(family)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(BACKLOG)
    except OSError as error:
        raise UserError(
            f"the page cannot listen on {host}, port {port}: {error.strerror}"
        ) from None
    return listener


def _inherited() -> socket.socket | None:
    """Return the listening socket that is the standard input; None if that is something else."""
    try:
        candidate = socket.socket(fileno=os.dup(sys.stdin.fileno()))
    except (OSError, ValueError, AttributeError):
        return None
    try:
        if candidate.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
            return candidate
    except OSError:
        pass
    candidate.close()
    return None
