"""Addresses that servers listen on."""

from __future__ import annotations

import ipaddress
import socket


def is_local(host: str) -> bool:
    """Return whether an address is that of this host alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def address(scheme: str, host: str, port: int) -> str:
    """Return the address by which a client finds a server.

    Args:
        scheme: Protocol, such as "http".
        host: Address that the server listens on.
        port: Its port.

    Example:
        >>> address("ws", "::1", 8765)
        'ws://[::1]:8765'
    """
    if host in ("0.0.0.0", "::", ""):
        host = socket.gethostname()
    shown = f"[{host}]" if ":" in host else host
    return f"{scheme}://{shown}:{port}"
