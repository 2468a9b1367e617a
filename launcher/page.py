"""The door of the page: the socket on which browsers find it, open before its process has started."""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import secrets
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from launcher.errors import UsageError

LOCAL = "127.0.0.1"
FIRST_PORT = 8070
LAST_PORT = 8099  # of those that are tried; then any free one
MAX_PORT = 65535
TOKEN_VARIABLE = "MOBO_PAGE_TOKEN"  # also defined in `mobo_tuner.nodes.page`
_BACKLOG = 64


class PageDoor:
    """The socket of a run's page, which its process gets as its standard input.

    A browser that comes early waits at the socket until the page serves it. If the page does not start,
    the browser is told so when the run ends; the run does not depend on it.

    Args:
        listener: Socket that listens; None if there is no page.
        host: Address that it listens on.
        browser: Whether to open the page in a browser.
    """

    def __init__(
        self, listener: socket.socket | None, host: str = LOCAL, *, browser: bool = False
    ) -> None:
        self._listener = listener
        self._host = host
        self._browser = browser
        self._token = "" if is_local(host) else secrets.token_urlsafe(24)

    @classmethod
    @contextmanager
    def open(cls, options: argparse.Namespace) -> Iterator[PageDoor]:
        """Listen for browsers as the command line says.

        Raises:
            UsageError: If nobody can listen there.
        """
        if options.no_dashboard:
            yield cls(None)
            return
        listener = _listen(options.page_host, options.port)
        desktop = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
        browser = desktop and sys.stdout.isatty() and not options.no_browser
        with listener:
            yield cls(listener, options.page_host, browser=browser)

    @property
    def is_open(self) -> bool:
        """Whether there is a page."""
        return self._listener is not None

    @property
    def stdin(self) -> int:
        """File descriptor for the standard input of the page's process."""
        return subprocess.DEVNULL if self._listener is None else self._listener.fileno()

    @property
    def parameters(self) -> Mapping[str, object]:
        """Parameters of the page's node."""
        port = 0 if self._listener is None else self._listener.getsockname()[1]
        return {"host": self._host, "port": port}

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables of the page's process; unlike its arguments, others cannot read them."""
        return {TOKEN_VARIABLE: self._token} if self._token else {}

    @property
    def address(self) -> str:
        """Address for a browser."""
        host = socket.gethostname() if self._host in ("0.0.0.0", "::") else self._host
        shown = f"[{host}]" if ":" in host else host
        query = f"?token={self._token}" if self._token else ""
        return f"http://{shown}:{self.parameters['port']}/{query}"

    def announce(self) -> None:
        """Print the address, and open it in a browser on a desktop."""
        if not self.is_open:
            return
        print(f"page: {self.address}", flush=True)
        if self._browser:
            with contextlib.suppress(OSError):
                # Not one of the processes of the run: the browser stays when the run has ended.
                subprocess.Popen(
                    [sys.executable, "-m", "webbrowser", self.address],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )


# `mobo_tuner.addresses` defines it, too, which this script cannot import: it runs before anything is installed.
def is_local(host: str) -> bool:
    """Return whether an address is that of this host alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _listen(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens on a port, or on the first free one.

    Raises:
        UsageError: If nobody can listen there.
    """
    ports = (port,) if port is not None else (*range(FIRST_PORT, LAST_PORT + 1), 0)
    reason = ""
    for number in ports:
        listener = None
        try:
            family, *_ = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0]
            listener = socket.socket(family)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((host, number))
            listener.listen(_BACKLOG)
            return listener
        except OSError as error:
            reason = error.strerror or str(error)
            if listener is not None:
                listener.close()
    if port is not None:
        raise UsageError(f"--port is {port}, where the page cannot listen on {host}: {reason}")
    raise UsageError(f"--page-host is {host!r}, where the page cannot listen: {reason}")
