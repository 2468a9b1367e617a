"""A separate ROS domain, so that concurrent runs do not receive each other's messages.

Domains 1 to 101 are chosen: DDS derives its UDP ports from the domain, and those of higher domains are in
the range of ephemeral ports. A laboratory may have its nodes in any up to 232. A domain is reserved by a lock
on a file in the temporary folder, which the kernel releases when its holder ends. Nodes that were started in
other ways have no lock, so their ports are checked too.
"""

from __future__ import annotations

import fcntl
import os
import random
import socket
import tempfile
from pathlib import Path
from types import TracebackType

from launcher.errors import DomainError

PROFILE = Path(__file__).parent / "discovery.xml"
FIRST, LAST = 1, 101
HIGHEST = 232
"""Highest domain for whose ports there are numbers."""
_PARTICIPANTS = 10  # number of other programs whose ports are checked in a domain


class RosDomain:
    """A domain that is reserved for this process until it is closed.

    Attributes:
        id: Id of the domain.
    """

    def __init__(self, domain_id: int | None = None, *, network: bool = False) -> None:
        """Reserve the given domain, or any free one.

        A given domain may contain nodes of other programs: the user may want to communicate with
        them.

        Args:
            domain_id: Id of the domain; None for any.
            network: Whether programs on other hosts may take part.

        Raises:
            DomainError: If it is reserved by another run, or all are.
        """
        self._network = network
        if domain_id is not None:
            descriptor = _lock(domain_id)
            if descriptor is None:
                raise DomainError(f"ROS domain {domain_id} is taken by another run")
            self.id, self._descriptor = domain_id, descriptor
            return
        for candidate in random.sample(range(FIRST, LAST + 1), LAST - FIRST + 1):
            descriptor = _lock(candidate)
            if descriptor is None:
                continue
            if _is_silent(candidate):
                self.id, self._descriptor = candidate, descriptor
                return
            os.close(descriptor)
        raise DomainError(f"no ROS domain from {FIRST} to {LAST} is free")

    def __enter__(self) -> RosDomain:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the domain."""
        os.close(self._descriptor)

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables of all programs in this domain."""
        return surroundings(self.id, self._network)


def surroundings(domain_id: int, network: bool = False) -> dict[str, str]:
    """Return the environment variables of the programs in a domain.

    Args:
        domain_id: Id of the domain.
        network: Whether programs on other hosts may take part.
    """
    return {
        "ROS_DOMAIN_ID": str(domain_id),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET" if network else "LOCALHOST",
        # Shared memory of a killed process remains and can block later processes.
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE),
    }


def _lock(domain_id: int) -> int | None:
    """Return a descriptor that holds the domain's lock; None if another process has it."""
    path = os.path.join(tempfile.gettempdir(), f"mobo-ros-domain-{domain_id}.lock")
    try:
        # Another user's file can be locked, but not opened for writing.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError:
            return None
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _is_silent(domain_id: int) -> bool:
    """Return whether the ports of a domain's first participants are all free."""
    for participant in range(_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain_id + 10 + 2 * participant))
            except OSError:
                return False
    return True
