"""The laboratory's own logbook: what its command gets, and that it harms nothing."""

from __future__ import annotations

import json
import shlex
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from launcher.logbook import ON_REQUEST, enter
from launcher.processes import Processes
from launcher.run_folder import RunFolder

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SUMMARY = {
    "evaluations": 8,
    "failed": 1,
    "hypervolume": 12.5,
    "stop_reason": "budget",
    "pareto_front": [{"index": 3, "setpoint": {"x": 1.0}, "objectives": {"f1": 0.5, "f2": 2.0}}],
}


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    path = tmp_path / "night"
    path.mkdir()
    (path / "run.json").write_text(json.dumps({"state": "finished", "reason": ""}))
    (path / "summary.json").write_text(json.dumps(SUMMARY))
    return RunFolder(path)


@pytest.fixture
def processes() -> Iterator[Processes]:
    with Processes() as processes:
        yield processes


def python(*words: str) -> str:
    return shlex.join([sys.executable, *words])


def test_a_command_gets_the_run_as_json(
    folder: RunFolder, processes: Processes, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.json"
    program = f"import sys; open({str(copy)!r}, 'w').write(sys.stdin.read())"
    assert enter(processes, python("-c", program), ON_REQUEST, folder) == ""
    content = json.loads(copy.read_text())
    assert content["event"] == "on_request"
    assert content["summary"] == SUMMARY
    assert content["run_folder"] == str(folder.path.resolve())
    assert (content["run_id"], content["state"], content["report"]) == ("night", "finished", None)


@pytest.mark.parametrize(
    ("command", "trouble"),
    [
        (python("-c", "import sys; sys.exit(3)"), "3"),
        (python("-c", "import time; time.sleep(100)"), "stopped after 0.5 s"),
        ("/nowhere/logbook", "/nowhere/logbook"),
    ],
)
def test_a_command_that_fails_or_hangs_is_told(
    folder: RunFolder, processes: Processes, command: str, trouble: str
) -> None:
    before = {path.name: path.read_bytes() for path in folder.path.glob("*.json")}
    timeout = 0.5 if "sleep" in command else 60.0
    assert trouble in enter(processes, command, ON_REQUEST, folder, timeout)
    assert {path.name: path.read_bytes() for path in folder.path.glob("*.json")} == before


def test_the_examples_write_markdown_an_email_and_to_an_elog(
    folder: RunFolder, processes: Processes, tmp_path: Path
) -> None:
    posted: list[tuple[str, bytes]] = []

    class Elog(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            posted.append((self.headers["Content-Type"], body))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    book = tmp_path / "book.md"
    command = python(str(EXAMPLES / "logbook_markdown.py"), str(book))
    assert enter(processes, command, ON_REQUEST, folder) == ""
    assert "## Run night: finished" in book.read_text()
    assert "| 3 | 0.5 | 2 |" in book.read_text()

    command = python(str(EXAMPLES / "logbook_email.py"), "shift@lab.example")
    assert enter(processes, command, ON_REQUEST, folder) == ""
    printed = (folder.path / "log" / "logbook.log").read_text()
    assert "Subject: Tuning run night: finished" in printed

    with ThreadingHTTPServer(("127.0.0.1", 0), Elog) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        address = f"http://127.0.0.1:{server.server_port}/shift"
        trouble = enter(
            processes, python(str(EXAMPLES / "logbook_elog.py"), address), ON_REQUEST, folder
        )
        server.shutdown()
        thread.join()
    assert trouble == ""
    [(kind, body)] = posted
    assert kind.startswith("multipart/form-data; boundary=")
    assert b'name="cmd"\r\n\r\nSubmit' in body
    assert b'name="exp"\r\n\r\nshift' in body
    assert b"Tuning run night: finished" in body
