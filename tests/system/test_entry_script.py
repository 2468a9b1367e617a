"""The entry script's command line and its runs, with real processes in the place of the nodes."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from launcher.programs import NodeProgram
from launcher.ros_domain import RosDomain
from launcher.run_folder import process_start
from launcher.supervisor import EXIT_LIMIT
from tests.support.fake_project import ROOT, TIMEOUT, FakeProject, wait_until

ALL = ("machine", "tuner", "recorder", "console")


@pytest.fixture
def project(tmp_path: Path) -> Iterator[FakeProject]:
    project = FakeProject(tmp_path)
    yield project
    project.close()


def mobo(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(ROOT / "mobo.py"), *arguments],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=False,
    )


# ------------------------------------------------------------------ the command line


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["run", "--evaluations", "0"], "--evaluations"),
        (["run", "--evaluations", "many"], "--evaluations"),
        (["run", "--evaluations", "1" * 5000], "--evaluations"),
        (["run", "--seed", "-1"], "--seed"),
        (["run", "--seed", "0.5"], "--seed"),
        (["run", "--speed", "0"], "--speed"),
        (["run", "--speed", "nan"], "--speed"),
        (["run", "--speed", "inf"], "--speed"),
        (["run", "--run-id", "../elsewhere"], "../elsewhere"),
        (["run", "--run-id", ".hidden"], ".hidden"),
        (["run", "--run-id", ""], "--run-id"),
        (["run", "--domain-id", "233"], "--domain-id"),
        (["run", "--config", "nowhere.yaml"], "nowhere.yaml"),
        (["run", "--eval", "3"], "--eval"),
        (["walk"], "walk"),
        ([], "VERB"),
        (["resume"], "RUN"),
        (["report"], "RUN"),
        (["resume", "some-run", "--evaluations", "0"], "--evaluations"),
    ],
)
def test_a_wrong_command_line_is_one_sentence(arguments: list[str], named: str) -> None:
    done = mobo(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert named in done.stderr


@pytest.mark.parametrize("closed", [(1,), (0, 1, 2)])
def test_closed_streams_are_no_error(tmp_path: Path, closed: tuple[int, ...]) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "mobo.py"), "list", "--runs-dir", str(tmp_path)],
        stderr=subprocess.PIPE,
        preexec_fn=lambda: os.closerange(closed[0], closed[-1] + 1),
        timeout=TIMEOUT,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")


def test_help_names_every_verb() -> None:
    done = mobo("--help")
    assert done.returncode == 0
    for verb in (
        "run",
        "check",
        "test",
        "list",
        "show",
        "resume",
        "report",
        "compare",
        "export",
        "rebuild",
        "replay",
    ):
        assert f"\n    {verb} " in done.stdout


def test_parameters_reach_a_node_as_the_types_they_are(tmp_path: Path) -> None:
    program = NodeProgram("program", "-", "tuner", ("run_id", "seed", "speed", "runs_dir"))
    values = {"run_id": "1e5", "seed": 3, "speed": 2.0, "runs_dir": Path("/it's here")}
    config = tmp_path / "config.yaml"
    sections = ("/**", "tuner")
    config.write_text(
        "".join(f"{s}: {{ros__parameters: {{seed: 1, kept: 2}}}}\n" for s in sections)
    )
    node = """
import json, sys, rclpy
rclpy.init(args=sys.argv)
node = rclpy.create_node("tuner", automatically_declare_parameters_from_overrides=True)
names = ("run_id", "seed", "speed", "runs_dir", "kept")
print(json.dumps({name: node.get_parameter(name).value for name in names}))
rclpy.shutdown()
"""
    arguments = program.command(Path(sys.executable), config, values)[4:]
    done = subprocess.run(
        [sys.executable, "-c", node, *arguments],
        env={**os.environ, "ROS_LOG_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=True,
    )
    expected = {"run_id": "1e5", "seed": 3, "speed": 2.0, "runs_dir": "/it's here", "kept": 2}
    assert json.loads(done.stdout) == expected


def test_a_parameter_without_a_value_is_left_to_the_configuration() -> None:
    program = NodeProgram("program", "package.tuner", "tuner", ("seed", "speed"))
    command = program.command(Path("python"), Path("config.yaml"), {"seed": 3, "speed": None})
    assert command == [
        *("python", "-P", "-m", "package.tuner", "--ros-args", "--params-file", "config.yaml"),
        *("-p", "tuner:seed:=3"),
    ]


# ------------------------------------------------------------------ runs that go well


def test_a_run_leaves_its_folder_and_nothing_else(project: FakeProject) -> None:
    status, output, errors = project.run("run", "--evaluations", "7", "--speed", "20")
    assert (status, errors) == (0, "")
    lines = output.splitlines()
    folder = Path(lines[-1])
    assert folder.parent == project.root / "runs"
    assert "tuning" in lines
    assert "the front" in lines
    facts = json.loads((folder / "run.json").read_text())
    assert facts["state"] == "finished"
    assert facts["reason"] == ""
    assert facts["arguments"]["evaluations"] == 7
    assert f"ROS_DOMAIN_ID={facts['domain_id']}" in output
    assert facts["machine"] == {"section": "awa_sim", "files": []}
    assert (folder / "config.yaml").read_text() == "/**: {}\n"
    assert {path.name for path in (folder / "log").iterdir()} >= {f"{name}.log" for name in ALL}
    assert project.alive() == []


def test_the_recorder_is_stopped_last(project: FakeProject) -> None:
    assert project.run("run", machine="slow", tuner="slow")[0] == 0
    events = project.events
    recorder = events.index("recorder stopping")
    assert events.index("machine stopped") < recorder
    assert events.index("tuner stopped") < recorder


def test_runs_get_names_of_their_own(project: FakeProject) -> None:
    first, second = project.start("run"), project.start("run")
    folders = {p.communicate(timeout=TIMEOUT)[0].splitlines()[-1] for p in (first, second)}
    assert len(folders) == 2
    domains = {json.loads(Path(f, "run.json").read_text())["domain_id"] for f in folders}
    assert len(domains) == 2


def test_a_run_is_never_overwritten(project: FakeProject) -> None:
    folder = project.root / "runs" / "mine"
    folder.mkdir(parents=True)
    status, output, errors = project.run("run", "--run-id", "mine")
    assert (status, output) == (2, "")
    assert errors == (
        f"mobo.py: the run 'mine' exists already in '{folder.parent}', "
        "and no run is ever overwritten\n"
    )
    assert list(folder.iterdir()) == []
    assert project.events == []


def test_a_bad_configuration_starts_nothing(project: FakeProject) -> None:
    status, output, errors = project.run("run", check_config="refuse")
    assert (status, output) == (2, "")
    assert errors == "mobo.py: reference of eps_x is 1.0; it must lie in its truncation box\n"
    assert {event.split()[0] for event in project.events} == {"check_config"}
    assert not (project.root / "runs").exists()


# ------------------------------------------------------------------ which machine


def facts_of(output: str) -> dict[str, Any]:
    facts: dict[str, Any] = json.loads(Path(output.splitlines()[-1], "run.json").read_text())
    return facts


def test_a_program_is_started_as_the_machine_and_again_when_the_run_is_resumed(
    project: FakeProject, tmp_path: Path
) -> None:
    folder = tmp_path / "lab"
    folder.mkdir()
    command = "python -m lab.machine --rate '2 Hz'"
    words = ("run", "--machine", command, "--run-id", "mine")
    status, output, errors = project.run(*words, folder=folder)
    assert (status, errors) == (0, "")
    assert facts_of(output)["machine"] == {"command": command, "folder": str(folder)}
    given = project.arguments("machine")
    assert given == [
        *("-m", "lab.machine", "--rate", "2 Hz", "--ros-args", "--params-file"),
        str(project.root / "runs" / "mine" / "config.yaml"),
    ]
    for number in (2, 3):
        status, output, errors = project.run("resume", "mine" if number == 2 else "mine-2")
        assert (status, errors) == (0, "")
        facts = facts_of(output)
        assert facts["run_id"] == f"mine-{number}"
        assert facts["machine"] == {"command": command, "folder": str(folder)}
        assert project.arguments("machine")[:4] == given[:4]


def test_another_machine_is_resumed_where_it_is_named(project: FakeProject) -> None:
    assert project.run("run", "--machine", "python -m lab.machine", "--run-id", "mine")[0] == 0
    status, output, _ = project.run("resume", "mine", "--machine", "python -m other.machine")
    assert status == 0
    assert facts_of(output)["machine"]["command"] == "python -m other.machine"
    assert project.arguments("machine")[1] == "other.machine"


def test_a_file_without_the_section_of_the_machine_is_not_resumed(project: FakeProject) -> None:
    assert project.run("run", "--run-id", "mine")[0] == 0
    config = str(project.root / "config" / "awa.yaml")
    status, _, errors = project.run("resume", "mine", "--config", config, check_config="external")
    assert status == 2
    assert config in errors
    assert "section 'awa_sim'" in errors
    # The run's own file is named, too, from which somebody has taken the section.
    status, _, errors = project.run("resume", "mine", check_config="external")
    assert status == 2
    assert str(project.root / "runs" / "mine" / "config.yaml") in errors
    assert not (project.root / "runs" / "mine-2").exists()


@pytest.mark.parametrize("way", ["--domain-id", "ROS_DOMAIN_ID"])
def test_a_machine_that_is_there_already_is_met_in_its_domain(
    project: FakeProject, way: str
) -> None:
    with RosDomain() as free, RosDomain() as other:
        domain = free.id
    options = ["--domain-id", str(domain)] if way == "--domain-id" else []
    variables = {"ROS_DOMAIN_ID": str(other.id if options else domain)}
    words = ("run", *options, "--run-id", "mine")
    status, output, errors = project.run(*words, variables=variables, check_config="external")
    assert (status, errors) == (0, "")
    assert f"ROS domain {domain} ({way})" in output.splitlines()[0]
    facts = facts_of(output)
    assert (facts["domain_id"], facts["machine"]) == (domain, {"external": True})
    assert not any(event.startswith("machine") for event in project.events)
    # It is looked for in the same domain when the run is resumed.
    variables = {"ROS_DOMAIN_ID": str(other.id)}
    status, output, _ = project.run("resume", "mine", variables=variables, check_config="external")
    assert (status, facts_of(output)["domain_id"]) == (0, domain)


@pytest.mark.parametrize(
    ("words", "behaviour", "variables", "named"),
    [
        (["--machine", "nowhere --fast"], "", {}, "nowhere --fast"),
        (["--machine", "./nowhere"], "", {}, "./nowhere"),
        (["--machine", ""], "", {}, "--machine"),
        (["--machine", "python 'open"], "", {}, "python 'open"),
        (["--machine", "python -m lab.machine", "--speed", "3"], "", {}, "--speed is 3"),
        (["--speed", "3"], "external", {}, "--speed is 3"),
        ([], "external", {"ROS_DOMAIN_ID": "233"}, "ROS_DOMAIN_ID is '233'"),
        ([], "external", {"ROS_DOMAIN_ID": "lab"}, "ROS_DOMAIN_ID is 'lab'"),
    ],
)
def test_a_machine_that_cannot_be_is_one_sentence(
    project: FakeProject, words: list[str], behaviour: str, variables: dict[str, str], named: str
) -> None:
    status, output, errors = project.run("run", *words, variables=variables, check_config=behaviour)
    assert (status, output) == (2, "")
    assert errors.count("\n") == 1
    assert named in errors
    assert not (project.root / "runs").exists()


def test_a_program_that_does_not_handle_ctrl_c_spoils_no_run(project: FakeProject) -> None:
    command = "sh -c 'exec sleep 60' machine"
    assert project.run("run", "--machine", command)[0] == 0


# ------------------------------------------------------------------ runs that fail


def failure(project: FakeProject, output: str) -> dict[str, Any]:
    folder = Path(output.splitlines()[-1])
    facts: dict[str, Any] = json.loads((folder / "run.json").read_text())
    assert project.alive() == []
    return facts


def test_a_killed_machine_ends_the_run(project: FakeProject) -> None:
    process = project.start("run", console="wait")
    project.wait_for_event("console ready")
    start = next(event for event in project.events if event.startswith("machine started"))
    os.kill(int(start.split()[-1]), signal.SIGKILL)
    output, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 1
    assert errors.startswith("mobo.py: the run failed: the machine node was killed by SIGKILL\n")
    assert failure(project, output)["state"] == "failed"
    assert "recorder stopped" in project.events
    assert "the front" in output


def test_a_node_that_dies_is_named_with_its_last_words(project: FakeProject) -> None:
    status, output, errors = project.run("run", tuner="crash", console="wait")
    assert status == 1
    assert "the tuner node ended with status 3" in errors.splitlines()[0]
    assert "    the magnet quenched" in errors.splitlines()
    assert (
        failure(project, output)["reason"] == "the run failed: the tuner node ended with status 3"
    )


def test_the_consoles_last_words_are_the_reason(project: FakeProject) -> None:
    status, output, errors = project.run("run", console="fail")
    assert status == 1
    assert errors == "mobo.py: the run failed: the machine refused evaluation 3\n"
    assert failure(project, output)["state"] == "failed"


def test_a_run_goes_on_without_its_recorder_and_says_so(project: FakeProject) -> None:
    status, output, errors = project.run("run", console="outlives", recorder="dies")
    assert status == 0
    facts = json.loads((Path(output.splitlines()[-1]) / "run.json").read_text())
    assert facts["state"] == "finished"
    assert "the recorder node was killed" in facts["reason"]
    assert errors == f"mobo.py: {facts['reason']}\n"


@pytest.mark.parametrize("behaviour", ["ends badly", "stubborn"])
def test_a_recorder_that_does_not_end_well_is_told_of(project: FakeProject, behaviour: str) -> None:
    status, output, errors = project.run("run", recorder=behaviour)
    assert status == 0
    facts = json.loads((Path(output.splitlines()[-1]) / "run.json").read_text())
    assert facts["state"] == "finished"
    assert "the recorder node" in facts["reason"]
    assert errors == f"mobo.py: {facts['reason']}\n"


def test_a_failed_report_fails_the_run(project: FakeProject) -> None:
    status, output, errors = project.run("run", report="crash")
    assert status == 1
    assert errors == "mobo.py: the report failed: the journal is damaged\n"
    assert failure(project, output)["state"] == "failed"


def entered(project: FakeProject, then: str = "") -> tuple[str, str]:
    """Options that make the logbook a copy of what its command gets, and then do something else."""
    copy = f"open({str(project.root / 'entry.json')!r}, 'w').write(sys.stdin.read())"
    return "--on-run-end", shlex.join([sys.executable, "-c", f"import sys, time; {copy}; {then}"])


def entry(project: FakeProject) -> dict[str, Any]:
    """What the logbook's command got."""
    content = json.loads((project.root / "entry.json").read_text())
    assert isinstance(content, dict)
    return content


def test_a_run_that_another_client_cancels_is_canceled(project: FakeProject) -> None:
    status, output, errors = project.run("run", *entered(project), console="canceled")
    assert status == 130
    assert errors == "mobo.py: the run was canceled by another client\n"
    assert failure(project, output)["state"] == "canceled"
    assert entry(project)["state"] == "canceled"


def test_a_taken_domain_is_refused(project: FakeProject) -> None:
    process = project.start("run", console="wait")
    project.wait_for_event("console ready")
    (run_file,) = (project.root / "runs").glob("*/run.json")
    domain = json.loads(run_file.read_text())["domain_id"]
    status, _, errors = project.run("run", "--domain-id", str(domain))
    assert (status, errors) == (1, f"mobo.py: ROS domain {domain} is taken by another run\n")
    process.terminate()
    process.communicate(timeout=TIMEOUT)


# ------------------------------------------------------------------ signals


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("event", ["check_config", "machine started", "console ready"])
def test_a_signal_ends_everything_in_time(
    project: FakeProject, number: signal.Signals, event: str
) -> None:
    process = project.start("run", console="wait", machine="family", tuner="stubborn")
    wait_until(lambda: any(e.startswith(event) for e in project.events), event)
    process.send_signal(number)
    sent = time.monotonic()
    output, errors = process.communicate(timeout=TIMEOUT)
    assert time.monotonic() - sent < EXIT_LIMIT
    assert process.returncode == 128 + number
    assert f"stopped by {number.name}" in errors
    assert project.alive() == []
    if event == "console ready":
        assert failure(project, output)["state"] == "interrupted"
        assert project.events.index("console stopped") < project.events.index("machine stopping")
        assert "recorder stopped" in project.events


def test_a_run_that_a_signal_ends_is_in_the_logbook_and_another_signal_ends_its_command(
    project: FakeProject,
) -> None:
    process = project.start("run", *entered(project, "time.sleep(1000)"), console="wait")
    project.wait_for_event("console ready")
    process.send_signal(signal.SIGINT)
    path = project.root / "entry.json"
    wait_until(lambda: path.exists() and path.read_text().endswith("}"), "the entry")
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 130
    assert "for the logbook was interrupted" in errors
    assert failure(project, output)["state"] == entry(project)["state"] == "interrupted"


def test_an_impatient_user_does_not_spoil_the_bag(project: FakeProject) -> None:
    process = project.start("run", console="wait", recorder="slow")
    project.wait_for_event("console ready")
    process.send_signal(signal.SIGINT)
    project.wait_for_event("recorder stopping")
    for _ in range(3):
        process.send_signal(signal.SIGINT)
    process.communicate(timeout=TIMEOUT)
    assert project.events.count("recorder stopping") == 1
    assert "recorder stopped" in project.events


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_waits_for_a_machine_that_goes_back(
    project: FakeProject, number: signal.Signals
) -> None:
    process = project.start("run", check_config="restore", console="goes back")
    project.wait_for_event("console ready")
    process.send_signal(number)
    output, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 128 + number
    assert failure(project, output)["state"] == "interrupted"
    assert errors == f"mobo.py: the run was stopped by {number.name}\n"
    events = project.events
    assert events.index("console stopped") < events.index("machine stopping")
    assert "console stopping again" not in events


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_second_signal_does_not_wait_for_a_machine_that_goes_back(
    project: FakeProject, number: signal.Signals
) -> None:
    process = project.start("run", check_config="restore", console="goes back")
    project.wait_for_event("console ready")
    process.send_signal(signal.SIGINT)
    project.wait_for_event("console stopping")
    process.send_signal(number)
    sent = time.monotonic()
    project.wait_for_event("console stopping again")
    output, _ = process.communicate(timeout=TIMEOUT)
    assert time.monotonic() - sent < EXIT_LIMIT
    assert process.returncode == 128 + number
    assert failure(project, output)["state"] == "interrupted"


def test_a_killed_entry_script_leaves_no_process(project: FakeProject) -> None:
    process = project.start(
        "run", console="wait", machine="family", tuner="stubborn", recorder="slow"
    )
    project.wait_for_event("console ready", "page ready")
    assert len(project.alive()) == 6
    process.kill()
    process.communicate(timeout=TIMEOUT)
    wait_until(lambda: project.alive() == [], "the end of everything")
    assert "recorder stopped" in project.events
    status, output, _ = project.run("list")
    assert status == 0
    assert " died " in output


# ------------------------------------------------------------------ test


def test_the_tests_get_their_arguments_and_give_their_status(
    project: FakeProject, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", "elsewhere")
    assert project.run("test", "-k", "name", "--help") == (5, "-k name --help None\n", "")
    assert project.run("test") == (
        5,
        "-n 3 --dist loadfile --no-loadscope-reorder --reruns 1 --rerun-show-tracebacks -rR None\n",
        "",
    )


def test_interrupted_tests_end(project: FakeProject) -> None:
    process = project.start("test", pytest="wait")
    wait_until(lambda: bool(project.alive()), "pytest")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=TIMEOUT)
    assert (process.returncode, errors) == (130, "mobo.py: stopped by SIGINT\n")
    assert project.alive() == []


# ------------------------------------------------------------------ list and show

SUMMARY: dict[str, Any] = {
    "evaluations": 3,
    "failed": 1,
    "feasible": 2,
    "hypervolume": 1234.5678,
    "stop_reason": "budget",
    "pareto_front": [
        {"index": 0, "setpoint": {"K1": 512.0}, "objectives": {"eps_x": 38.25, "dE": 0.25}},
        {"index": 2, "setpoint": {"K1": 430.0}, "objectives": {"eps_x": 41.5, "dE": None}},
    ],
}


def make_run(runs_dir: Path, run_id: str, facts: Any, summary: Any = None) -> Path:
    folder = runs_dir / run_id
    folder.mkdir(parents=True)
    for name, content in (("run.json", facts), ("summary.json", summary)):
        if content is not None:
            text = content if isinstance(content, str) else json.dumps(content)
            (folder / name).write_text(text)
    return folder


def test_a_run_with_a_large_front_fits_a_screen(tmp_path: Path) -> None:
    point = SUMMARY["pareto_front"][0]
    front = [{**point, "index": index} for index in range(1527)]
    make_run(tmp_path, "a", {"state": "finished"}, {**SUMMARY, "pareto_front": front})
    lines = mobo("show", "a", "--runs-dir", str(tmp_path)).stdout.splitlines()
    assert len(lines) <= 40
    assert "1527 points" in "".join(lines)
    assert "1519 more" in lines[-1]


def test_list_tells_the_state_of_every_run(tmp_path: Path) -> None:
    here = {"pid": os.getpid(), "pid_started": process_start(os.getpid())}
    start = {"started": "2026-11-23T15:42:10+01:00"}
    make_run(tmp_path, "a", {"state": "finished", **start}, SUMMARY)
    make_run(tmp_path, "b", {"state": "running", **here, **start})
    make_run(tmp_path, "c", {"state": "running", **here, "pid_started": "1", **start})
    make_run(tmp_path, "d", {"state": "running", **start})
    make_run(tmp_path, "e", "{")
    make_run(tmp_path, "f", [1, 2])
    (tmp_path / "no-run").mkdir()
    done = mobo("list", "--runs-dir", str(tmp_path))
    assert done.returncode == 0
    rows = [line.split() for line in done.stdout.splitlines()]
    assert rows[0] == ["run", "state", "evaluations", "hypervolume", "started"]
    assert rows[1] == ["a", "finished", "3", "1234.57", start["started"]]
    assert [row[:2] for row in rows[2:]] == [
        ["b", "running"],
        ["c", "died"],
        ["d", "died"],
        ["e", "unreadable"],
        ["f", "unreadable"],
    ]
    assert len(done.stderr.splitlines()) == 2


def test_list_of_an_empty_folder_says_so(tmp_path: Path) -> None:
    done = mobo("list", "--runs-dir", str(tmp_path))
    assert (done.returncode, done.stdout) == (0, f"there are no runs in '{tmp_path}'\n")


def test_show_prints_the_facts_and_the_front(tmp_path: Path) -> None:
    folder = make_run(tmp_path, "a", {"state": "finished"}, SUMMARY)
    by_id = mobo("show", "a", "--runs-dir", str(tmp_path))
    by_path = mobo("show", str(folder))
    assert by_id.returncode == 0
    assert by_id.stdout == by_path.stdout
    rows = [line.split() for line in by_id.stdout.splitlines()]
    assert ["hypervolume", "1234.57"] in rows
    assert ["index", "eps_x", "dE"] in rows
    assert ["2", "41.5", "-"] in rows
    assert ["0", "512"] in rows


@pytest.mark.parametrize(
    ("facts", "summary"),
    [
        ({}, "no JSON"),
        ({}, "[]"),
        ({}, {"evaluations": 3}),
        ({}, {"pareto_front": 3}),
        ({}, {"pareto_front": [3]}),
        ({}, {"pareto_front": [{"index": 0, "setpoint": 1, "objectives": 2}]}),
        ("\0", SUMMARY),
    ],
)
def test_show_of_a_broken_run_is_one_sentence(tmp_path: Path, facts: Any, summary: Any) -> None:
    make_run(tmp_path, "a", facts, summary)
    done = mobo("show", "a", "--runs-dir", str(tmp_path))
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert str(tmp_path / "a") in done.stderr


def test_a_reader_that_leaves_early_gets_no_traceback(tmp_path: Path) -> None:
    for number in range(3000):
        make_run(tmp_path, f"run-{number}", {"state": "finished"})
    script = f"'{sys.executable}' '{ROOT / 'mobo.py'}' list --runs-dir '{tmp_path}' | head -n 1"
    done = subprocess.run(
        ["sh", "-c", script], capture_output=True, text=True, timeout=TIMEOUT, check=True
    )
    assert done.stdout.startswith("run ")
    assert done.stderr == ""


def test_show_of_an_unknown_run_is_one_sentence(tmp_path: Path) -> None:
    done = mobo("show", "nobody", "--runs-dir", str(tmp_path))
    assert done.returncode == 1
    assert done.stderr == f"mobo.py: there is no run 'nobody' in '{tmp_path}'\n"
