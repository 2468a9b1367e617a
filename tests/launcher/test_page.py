"""The door of the page, and a run on which the page has no influence."""

from __future__ import annotations

import argparse
import re
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from launcher.errors import UsageError
from launcher.page import PageDoor
from tests.support.fake_project import FakeProject, wait_until


def options(**given: object) -> argparse.Namespace:
    """What the command line says of the page."""
    defaults = {"no_dashboard": False, "port": None, "page_host": "127.0.0.1", "no_browser": True}
    return argparse.Namespace(**{**defaults, **given})


@pytest.fixture
def taken() -> Iterator[int]:
    """A port on which somebody else listens."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        yield int(other.getsockname()[1])


@pytest.fixture
def project(tmp_path: Path) -> Iterator[FakeProject]:
    project = FakeProject(tmp_path)
    yield project
    project.close()


def test_the_socket_listens_before_the_page_has_started() -> None:
    with PageDoor.open(options()) as door:
        found = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/", door.address)
        assert found
        assert int(found[1]) == door.parameters["port"]
        with socket.create_connection(("127.0.0.1", int(found[1])), timeout=5.0):
            pass
        with socket.socket(fileno=door.stdin) as inherited:
            assert inherited.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
            inherited.detach()
        assert door.environment == {}


def test_two_pages_have_two_ports() -> None:
    with PageDoor.open(options()) as first, PageDoor.open(options()) as second:
        assert first.parameters["port"] != second.parameters["port"]


def test_a_port_that_is_taken_is_refused_by_name(taken: int) -> None:
    with pytest.raises(UsageError, match=f"--port is {taken}"), PageDoor.open(options(port=taken)):
        pass


def test_an_address_that_is_not_of_this_host_is_refused_by_name() -> None:
    host = "192.0.2.1"  # of documentation
    with pytest.raises(UsageError, match=host), PageDoor.open(options(page_host=host)):
        pass


def test_beyond_this_host_the_address_has_a_token_that_the_page_gets() -> None:
    with PageDoor.open(options(page_host="0.0.0.0")) as door:
        [token] = door.environment.values()
        assert door.address.endswith(f"/?token={token}")
        assert socket.gethostname() in door.address


def test_without_a_page_there_is_no_socket(capsys: pytest.CaptureFixture[str]) -> None:
    with PageDoor.open(options(no_dashboard=True)) as door:
        door.announce()
        assert not door.is_open
    assert capsys.readouterr().out == ""


def test_a_run_prints_the_address_on_a_line_of_its_own(project: FakeProject) -> None:
    status, output, errors = project.run("run", "--no-browser", "--run-id", "one", page="wait")
    assert (status, errors) == (0, "")
    lines = output.splitlines()
    assert len([line for line in lines if re.fullmatch(r"page: http://127.0.0.1:\d+/", line)]) == 1
    assert lines[-1] == str(project.root / "runs" / "one")
    assert "page stopped" in project.events
    words = project.arguments("page")
    assert "page:host:='127.0.0.1'" in words
    assert f"page:runs_dir:='{project.root / 'runs'}'" in words


def test_a_run_without_a_dashboard_has_no_page(project: FakeProject) -> None:
    status, output, _ = project.run("run", "--no-dashboard")
    assert status == 0
    assert "page:" not in output
    assert not any(event.startswith("page") for event in project.events)


def test_a_page_that_cannot_start_changes_nothing(project: FakeProject) -> None:
    status, output, errors = project.run("run", "--run-id", "one", page="crash")
    assert (status, errors) == (0, "")
    assert output.splitlines()[-1] == str(project.root / "runs" / "one")


def test_a_page_that_does_not_end_well_changes_nothing(project: FakeProject) -> None:
    status, _, errors = project.run("run", page="ends badly")
    assert (status, errors) == (0, "")


def test_a_page_that_dies_is_started_again_but_not_for_ever(project: FakeProject) -> None:
    process = project.start("run", "--run-id", "one", page="crash", console="wait")
    log = project.root / "runs" / "one" / "log" / "page.log"
    words = "the magnet quenched"
    wait_until(lambda: log.exists() and log.read_text().count(words) == 4, "four ends of the page")
    assert process.poll() is None
    process.terminate()
    process.communicate(timeout=20.0)
    assert log.read_text().count(words) == 4
    assert project.alive() == []


def test_a_taken_port_is_refused_before_anything_starts(project: FakeProject, taken: int) -> None:
    status, _, errors = project.run("run", "--port", str(taken))
    assert status == 2
    assert f"--port is {taken}" in errors
    assert project.events == []
