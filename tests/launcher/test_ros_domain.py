"""Domains of one's own."""

from __future__ import annotations

import socket
from xml.etree import ElementTree

import pytest

from launcher import ros_domain
from launcher.errors import DomainError
from launcher.ros_domain import RosDomain


def test_two_runs_get_two_domains() -> None:
    with RosDomain() as first, RosDomain() as second:
        assert first.id != second.id
        assert {first.id, second.id} <= set(range(1, 102))
        assert first.environment["ROS_DOMAIN_ID"] == str(first.id)
        assert first.environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
        profile = ElementTree.parse(first.environment["FASTRTPS_DEFAULT_PROFILES_FILE"])
        [period] = profile.iterfind(".//{*}leaseAnnouncement")
        assert [element.text for element in period] == ["0", "200000000"]


def test_a_domain_is_free_again_after_use() -> None:
    with RosDomain() as domain, pytest.raises(DomainError, match="is taken by another run"):
        RosDomain(domain.id)
    with RosDomain(domain.id) as again:
        assert again.id == domain.id


def test_a_domain_with_strangers_in_it_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with RosDomain() as domain:
        only = domain.id
    monkeypatch.setattr(ros_domain, "FIRST", only)
    monkeypatch.setattr(ros_domain, "LAST", only)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("", 7400 + 250 * only + 10 + 2))
        with pytest.raises(DomainError, match=f"no ROS domain from {only} to {only} is free"):
            RosDomain()
        with RosDomain(only) as chosen:  # who asks for it may want to meet them
            assert chosen.id == only
    with RosDomain() as found:
        assert found.id == only
