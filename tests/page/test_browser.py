"""The page in a browser, with a real tuner, the simulated machine and real nodes of the page.

The tests share the nodes and, in their order, one run: it is steered first, then stopped, then gone back to.
"""

from __future__ import annotations

import json
import re
import signal
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import rclpy
from axe_playwright_python.sync_playwright import Axe
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from playwright.sync_api import BrowserContext, Page, ViewportSize
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from launcher.ros_domain import RosDomain
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.client import TunerClient
from mobo_tuner.machine.double import Answer
from mobo_tuner.ros.executor_thread import ExecutorThread
from robustness.processes import NodeProcess, NodeStarter
from tests.support.browser import browser, read, until, watched
from tests.support.paths import CONFIG
from tests.support.processes import wait_until
from tests.support.tuner import toy_machine, toy_values

EVIL = "<img src=x onerror=window.hacked=1>"
ENDLESS = 5000  # evaluations
TOKEN = "the-token-of-a-test"
CONTROL_ROOM: ViewportSize = {"width": 1920, "height": 1080}


class Stage:
    """Nodes in a domain of their own, and a client that may start a run."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder = folder
        self.runs_dir = folder / "runs"
        self.start = NodeStarter(folder)
        self._toy = ("--ros-args", "--params-file", str(CONFIG / "toy.yaml"))
        self.client = TunerClient(domain_id=domain, timeout=30.0)
        self._pool = ThreadPoolExecutor(1)
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.rogue = Node("rogue", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.rogue)
        self._spinning: ExecutorThread | None = None
        past = self.runs_dir / "past"
        past.mkdir(parents=True)
        facts = {"state": "failed", "started": "2026-01-02T03:04:05+00:00", "reason": EVIL}
        (past / "run.json").write_text(json.dumps(facts), encoding="utf-8")
        self.machine = self.start(
            "-m", "awa_sim_node.node", *self._toy, "-p", "awa_sim:speed:=20.0"
        )
        self.tuner = self.start_tuner()
        self.page_process, self.address = self.start_page()

    def start_tuner(self) -> NodeProcess:
        given = (f"runs_dir:={self.runs_dir}", "initial_evaluations:=3", "on_failure:=ask")
        options = [word for text in given for word in ("-p", f"tuner:{text}")]
        return self.start("-m", "mobo_tuner.nodes.tuner", *self._toy, *options)

    def start_page(
        self, *parameters: str, port: int = 0, **environment: Any
    ) -> tuple[NodeProcess, str]:
        """A node of the page, and its address."""
        given = (f"port:={port}", f"runs_dir:={self.runs_dir}", *parameters)
        options = [word for text in given for word in ("-p", text)]
        process = self.start("-m", "mobo_tuner.nodes.page", "--ros-args", *options, **environment)
        wait_until(lambda: "page: " in process.stdout or not process.running, "the page's address")
        assert process.running, process.stderr
        found = re.search(r"^page: (http://\S+)$", process.stdout, flags=re.MULTILINE)
        assert found
        return process, found[1]

    def tune(self, run_id: str, evaluations: int = ENDLESS) -> None:
        """Start a run, which does not end of itself if nothing else is said."""
        self._pool.submit(self.client.tune, evaluations=evaluations, run_id=run_id)

    def replace_machine(self, answer: Callable[[EvaluateSetpoint.Goal], Answer]) -> None:
        """Have a double in this process in the place of the simulator."""
        self.machine.kill()
        self._spinning = ExecutorThread(self._executor, spin=True)
        self._spinning.call(lambda: toy_machine(self.rogue, answer))

    def close(self) -> None:
        self.client.close()
        if self._spinning is not None:
            self._spinning.close()
        self.rogue.destroy_node()
        self._context.try_shutdown()
        for process in self.start.processes:
            process.kill()
        self._pool.shutdown()


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("page")
    with RosDomain() as domain, pytest.MonkeyPatch.context() as patch:
        for name, value in domain.environment.items():
            patch.setenv(name, value)
        patch.setenv("ROS_LOG_DIR", str(folder / "log"))
        stage = Stage(folder, domain.id)
        stage.tune("steered")
        yield stage
        stage.close()


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrowserContext]:
    with browser(tmp_path_factory.mktemp("chromium"), viewport=CONTROL_ROOM) as context:
        yield context


@pytest.fixture(scope="module")
def shared(stage: Stage, chromium: BrowserContext) -> tuple[Page, list[str]]:
    """The page that all tests but a few look at, and what it has done wrong."""
    page = chromium.new_page()
    wrong = watched(page)
    page.goto(stage.address)
    until(page, lambda: count(page) >= 3, "the first evaluations")
    return page, wrong


@pytest.fixture
def page(shared: tuple[Page, list[str]]) -> Iterator[Page]:
    page, wrong = shared
    yield page
    assert wrong == []


def count(page: Page) -> int:
    """Number of finished evaluations that the page shows."""
    found = re.match(r"(\d+) / \d+", read(page, ".count"))
    return int(found[1]) if found else 0


def chosen(page: Page) -> int | None:
    """Index of the chosen point of the front."""
    found = re.match(r"Chosen is (\d+):", read(page, ".chosen"))
    return int(found[1]) if found else None


def choose_first(page: Page) -> int:
    """Choose the first point in the table; its index."""
    cells = page.locator(".point-table tbody tr:has(.q-checkbox)").first.locator("td")
    index = int(cells.nth(1).inner_text())
    cells.nth(2).click()
    until(page, lambda: chosen(page) == index, "the choice")
    return index


def word(page: Page) -> str:
    return read(page, ".state-word")


def press(page: Page, text: str) -> None:
    page.get_by_role("button", name=text, exact=True).click()


def answered(page: Page, pattern: str) -> None:
    """Wait for the answer of the tuner beside the buttons."""
    until(page, lambda: re.search(pattern, read(page, ".answer")), f"the answer {pattern}")


def test_the_page_shows_what_the_tuner_does(stage: Stage, page: Page) -> None:
    assert word(page) == "Running"
    assert read(page, ".run-id") == "run steered"
    assert read(page, ".live") == "● live"
    assert read(page, ".count").endswith(f"/ {ENDLESS}")
    moves = r"x1\s+\S+ → \S+\s+now "
    until(page, lambda: re.search(moves, read(page, ".motion-rows")), "what moves")
    until(page, lambda: "awa_sim: machine" in read(page, ".health"), "the machine's health")
    assert "✓ good" in read(page, ".health")
    until(page, lambda: page.title().startswith("Running"), "the title")
    with urllib.request.urlopen(stage.address, timeout=10.0) as answer:
        policy = answer.headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy


def test_a_run_is_paused_stepped_and_continued(page: Page) -> None:
    press(page, "Pause")
    until(page, lambda: word(page) == "Paused", "the pause")
    answered(page, "pause")
    before = count(page)
    press(page, "Step")
    answered(page, "1 more evaluation")
    # The count alone may be ahead of the state, and the buttons then change under the pointer.
    until(page, lambda: f"paused before evaluation {before + 1}:" in read(page, ".sentence"), "one")
    press(page, "Continue")
    until(page, lambda: word(page) == "Running" and count(page) > before + 1, "the run")


def test_a_change_is_refused_with_the_tuners_sentence_or_accepted(stage: Stage, page: Page) -> None:
    press(page, "Change…")
    page.get_by_label("new budget of evaluations").fill("1")
    page.get_by_label("new x1, upper bound").fill("1.5")
    press(page, "Apply")
    until(page, lambda: "evaluations is 1;" in read(page, ".change-dialog"), "the refusal")
    assert stage.client.get("variables.x1.max") == 2.0
    page.get_by_label("new budget of evaluations").fill("4000")
    press(page, "Apply")
    answered(page, r"^changed: ")
    assert stage.client.get("variables.x1.max") == 1.5
    until(page, lambda: read(page, ".count").endswith("/ 4000"), "the new budget")


def test_a_set_point_of_ones_own_is_evaluated_next(stage: Stage, page: Page) -> None:
    press(page, "Queue set-point…")
    page.get_by_label("x1, −2 to 1.5").fill("0.25")
    page.get_by_label("x2, −2 to 2").fill("7")
    press(page, "Queue it")
    until(page, lambda: "x2 is 7" in read(page, ".q-dialog .refused"), "the refusal")
    page.get_by_label("x2, −2 to 2").fill("-0.125")
    press(page, "Queue it")
    answered(page, "is queued")

    def operators() -> list[dict[str, float]]:
        lines = (stage.runs_dir / "steered" / "journal.jsonl").read_text().splitlines()
        records = [json.loads(line) for line in lines if line.endswith("}")]
        return [r["setpoint"] for r in records if r.get("source") == "operator"]

    until(page, lambda: operators() == [{"x1": 0.25, "x2": -0.125}], "its evaluation")


def test_a_click_on_the_front_chooses_a_point(page: Page) -> None:
    press(page, "Pause")
    until(page, lambda: word(page) == "Paused", "the pause")
    assert page.get_by_role("button", name="Go to point…", exact=True).is_disabled()
    page.wait_for_timeout(1000)  # the plots have been drawn for the last time
    place = page.evaluate(
        """() => {
          const element = document.querySelector(".front .chart");
          const chart = getElement(element.id.slice(1)).chart;
          const points = chart.getOption().series.find((s) => s.name === "front").data;
          const point = points[points.length - 1].value;  // the one that is drawn last, on top
          const box = element.getBoundingClientRect();
          const [x, y] = chart.convertToPixel({gridIndex: 0}, point.slice(0, 2));
          return {x: box.x + x, y: box.y + y, index: point[2]};
        }"""
    )
    page.mouse.click(place["x"], place["y"])
    until(page, lambda: chosen(page), "the choice")
    assert chosen(page) == place["index"]
    until(
        page,
        lambda: page.get_by_role("button", name="Go to point…", exact=True).is_enabled(),
        "the button",
    )


def test_what_comes_from_topics_and_files_is_never_read_as_html(stage: Stage, page: Page) -> None:
    publisher = stage.rogue.create_publisher(DiagnosticArray, "/diagnostics", 10)
    status = DiagnosticStatus(level=b"\x02", name=EVIL, message=EVIL)
    health = page.locator(".health")

    def shown() -> bool:
        publisher.publish(DiagnosticArray(status=[status]))
        return health.inner_text().count(EVIL) == 2

    until(page, shown, "the text")
    page.get_by_role("tab", name="History").click()
    until(page, lambda: EVIL in read(page, ".history-table"), "the past run")
    page.get_by_label("filter by id, state or reason").fill("steered")
    until(page, lambda: "past" not in read(page, ".history-table tbody"), "the filter")
    assert page.evaluate("window.hacked") is None


@pytest.mark.parametrize("tab", ["Variables", "Diagnostics", "Constraints", "All coordinates"])
def test_every_view_of_the_details_is_drawn(page: Page, tab: str) -> None:
    page.get_by_role("tab", name=tab).click()
    if tab == "Constraints":
        until(page, lambda: "no constraints" in read(page, ".details"), "the sentence")
    else:
        page.wait_for_selector(".details canvas")


def test_the_models_say_what_drives_what_through_the_chosen_point(page: Page) -> None:
    choose_first(page)
    page.get_by_role("tab", name="Models").click()
    note = ".details .card-head .quiet"
    until(page, lambda: f"evaluation {chosen(page)};" in read(page, note), "the answer", 120.0)
    assert re.search(r"explains \d+% of the variance", read(page, note))
    until(page, lambda: page.locator(".slice:has(canvas)").count() == 4, "two slices and two plots")
    page.get_by_role("tab", name="All coordinates").click()


def test_what_is_marked_on_an_axis_selects(page: Page) -> None:
    page.wait_for_selector(".details .wide canvas")
    page.wait_for_function(
        """() => {
          const element = document.querySelector(".details .wide");
          const lines = getElement(element.id.slice(1)).chart?.getOption()?.series?.[0]?.data;
          return lines && lines.length > 2;
        }"""
    )
    rows = page.locator(".point-table tbody tr")
    place = page.evaluate(
        """() => {
          const element = document.querySelector(".details .wide");
          element.scrollIntoView({block: "center"});
          const chart = getElement(element.id.slice(1)).chart;
          const axis = chart.getModel().getComponent("parallelAxis", 0).axis;
          const points = chart.getOption().series[0].data.map((line) => line.value[0]);
          const best = Math.min(...points);
          const box = element.getBoundingClientRect();
          const [x, y] = chart.getModel().getComponent("parallel", 0).coordinateSystem
            .dataToPoint(best, axis.dim);
          return {x: box.x + x, y: box.y + y, best};
        }"""
    )
    page.mouse.move(place["x"], place["y"] - 4)
    page.mouse.down()
    page.mouse.move(place["x"], place["y"] + 4, steps=4)
    page.mouse.up()
    page.evaluate("window.scrollTo(0, 0)")
    until(page, lambda: "in what you marked" in read(page, ".details .quiet"), "the selection")
    kept = re.match(r"(\d+) of (\d+) points", read(page, ".details .quiet"))
    assert kept
    assert 1 <= int(kept[1]) < int(kept[2])
    until(page, lambda: rows.count() >= int(kept[1]), "the rows")
    assert page.get_by_text(f"{place['best']:.4g}"[:5]).count() > 0
    press(page, "Show all points")
    until(page, lambda: "Drag along an axis" in read(page, ".details .quiet"), "all points")
    choose_first(page)


def barriers(page: Page) -> list[str]:
    """What keeps people with aids from reading or acting, as axe-core sees it.

    Its answer is asked for again and again: a call that awaited it would have no limit.
    """
    page.evaluate(Axe().axe_script)
    page.evaluate(
        """() => {
          window.found = null;
          axe.run({resultTypes: ["violations"]}).then(results => window.found = results.violations);
        }"""
    )
    until(page, lambda: page.evaluate("window.found") is not None, "the answer of axe-core")
    grave = [v for v in page.evaluate("window.found") if v["impact"] in ("serious", "critical")]
    return [f"{v['id']}: {v['nodes'][0]['html']}" for v in grave]


def assert_without_barriers(page: Page, what: str) -> None:
    deadline = time.monotonic() + 10.0
    while (found := barriers(page)) and time.monotonic() < deadline:
        page.wait_for_timeout(300)  # colours change slowly
    assert found == [], what


def test_people_with_aids_can_read_and_act(page: Page) -> None:
    for way in ("in the dark", "in the light"):
        for tab in ("Models", "History", "All coordinates"):
            page.get_by_role("tab", name=tab).click()
            page.wait_for_selector(
                ".history-table tbody" if tab == "History" else ".details canvas"
            )
            assert_without_barriers(page, f"{tab} {way}")
        page.get_by_role("button", name="light or dark").click()


def test_a_browser_that_was_away_for_a_while_is_where_it_was(page: Page) -> None:
    index = choose_first(page)
    page.evaluate("window.isTheSame = true")
    page.evaluate(
        """() => {
          const manager = window.socket.io;
          manager.reconnectionDelayMax(12e3);
          manager.reconnectionDelay(12e3);  // [ms], more than the server waits for an answer
          manager.engine.close();
        }"""
    )
    until(page, lambda: "lost its server" in read(page, "body"), "the warning")
    until(page, lambda: "lost its server" not in read(page, "body"), "the server")
    page.evaluate("window.socket.io.reconnectionDelay(1e3)")
    press(page, "Stop…")
    press(page, "No, go back")
    assert page.evaluate("window.isTheSame")
    assert chosen(page) == index


def test_a_phone_shows_the_front_too(page: Page) -> None:
    page.set_viewport_size({"width": 412, "height": 915})

    def shown() -> bool:
        box = page.locator(".front canvas").bounding_box()
        return box is not None and min(box["width"], box["height"]) >= 300.0

    until(page, shown, "the plot of the front")
    assert_without_barriers(page, "a phone")
    page.set_viewport_size(CONTROL_ROOM)


def test_a_run_is_stopped_only_after_a_question(page: Page) -> None:
    press(page, "Stop…")
    press(page, "No, go back")
    assert word(page) == "Paused"
    press(page, "Stop…")
    press(page, "Stop the run")
    until(page, lambda: word(page) == "Stopped", "the end")


def test_the_machine_goes_to_the_chosen_point_after_a_list_of_what_moves(page: Page) -> None:
    index = choose_first(page)
    press(page, "Go to point…")
    dialog = page.locator(".go-dialog")
    until(page, lambda: f"evaluation {index}?" in dialog.inner_text(), "the question")
    assert_without_barriers(page, "a dialog")
    rows = re.findall(r"(x\d)\s+(\S+) → (\S+)\s+(\d+)% of its range", dialog.inner_text())
    assert [row[0] for row in rows] == ["x1", "x2"]
    press(page, "Move the machine")
    answered(page, f"^the machine is at the point of evaluation {index}$")
    for name, _, target, _ in rows:
        until(
            page,
            lambda: re.search(rf"{name}\s+\S+ → {target}\s", read(page, ".motion-rows")),  # noqa: B023
            f"the move of {name}",
        )


def test_a_tuner_that_dies_is_said_to_be_silent_until_it_is_back(stage: Stage, page: Page) -> None:
    stage.tuner.kill()
    until(page, lambda: "stale" in read(page, ".live"), "the age")
    assert word(page) == "Tuner silent"
    assert page.get_by_role("button", name="Change…", exact=True).is_disabled()
    stage.tuner = stage.start_tuner()
    until(page, lambda: read(page, ".live") == "● live" and word(page) == "Idle", "the tuner")


def test_a_page_that_is_restarted_is_found_again(stage: Stage, page: Page) -> None:
    stage.page_process.popen.send_signal(signal.SIGINT)
    began = time.monotonic()
    assert stage.page_process.wait(10.0) == 0
    assert time.monotonic() - began < 5.0  # 1 s on a quiet machine
    until(page, lambda: "lost its server" in read(page, "body"), "the warning")
    port = int(stage.address.rstrip("/").rpartition(":")[2])
    stage.page_process, _ = stage.start_page(port=port)
    until(page, lambda: "lost its server" not in read(page, "body"), "the server")
    until(page, lambda: page.locator(".live.fresh").count() == 1, "the tuner")


def test_a_failure_asks_every_viewer_and_one_answers(
    stage: Stage, page: Page, chromium: BrowserContext
) -> None:
    def answer(goal: EvaluateSetpoint.Goal) -> Answer:
        failed = goal.index == 1
        code = EvaluateSetpoint.Result.INVALID_MEASUREMENT if failed else 0
        return Answer(
            {} if failed else toy_values(goal), code, f"attempt {goal.attempt}: no beam" * failed
        )

    stage.replace_machine(answer)
    stage.tune("asked", 5)
    question = page.locator(".question")
    until(page, lambda: "attempt 0: no beam. What now?" in question.inner_text(), "the question")
    assert page.get_by_role("button", name="Continue", exact=True).is_hidden()
    other = chromium.new_page()
    other.goto(stage.address)
    until(other, lambda: "no beam" in read(other, ".question"), "the question, for the other")
    other.get_by_role("button", name="Try again", exact=True).click()
    # One request is made at a time: the next one waits for the answer to this one.
    until(other, lambda: read(other, ".answer"), "the answer for the other")
    page.bring_to_front()
    until(page, lambda: "attempt 1: no beam" in question.inner_text(), "the next question")
    press(page, "Skip it")
    answered(page, "evaluation 1 is skipped")
    until(page, lambda: "ended after 5 evaluations" in question.inner_text(), "the end")
    until(other, lambda: "ended after 5" in read(other, ".question"), "the end, for the other")
    lines = (stage.runs_dir / "asked" / "journal.jsonl").read_text().splitlines()
    [failed] = [r for r in map(json.loads, lines) if r.get("error_msg") == "attempt 1: no beam"]
    assert (failed["index"], failed["valid"]) == (1, False)
    other.close()


def test_at_the_end_a_run_gets_more_evaluations_or_is_left(page: Page) -> None:
    press(page, "More evaluations…")
    page.get_by_label("evaluations more").fill("2")
    press(page, "Begin")
    answered(page, "continues run asked up to 7 evaluations")
    until(page, lambda: read(page, ".count") == "7 / 7", "the evaluations")
    until(page, lambda: "after 7 evaluations" in read(page, ".question"), "the end")
    press(page, "Restore…")
    press(page, "Move the machine")
    answered(page, "is where it was before run")
    press(page, "Leave it")
    until(page, lambda: not page.locator(".question").is_visible(), "the question to go")


def test_a_point_is_held(page: Page) -> None:
    choose_first(page)
    press(page, "Go to point…")
    page.get_by_label("evaluations to hold it against drift").fill("2")
    press(page, "Move the machine")
    answered(page, r"is at the point of evaluation \d+ and held it for 2 evaluations")


def test_past_runs_are_opened_and_compared(page: Page) -> None:
    page.get_by_role("tab", name="History").click()
    for run_id in ("steered", "asked"):
        page.get_by_role("checkbox", name=f"run {run_id}", exact=True).click()
    press(page, "Compare")
    until(page, lambda: page.locator(".details .slice:has(canvas)").count() == 1, "the plot")
    page.get_by_role("checkbox", name="run asked", exact=True).click()
    press(page, "Open")
    until(page, lambda: read(page, ".run-id").startswith("past run steered"), "the past run")
    assert page.get_by_role("button", name="Go to point…", exact=True).is_disabled()
    press(page, "Back to now")
    until(page, lambda: read(page, ".run-id").startswith("run "), "the run of now")


def test_beyond_this_host_only_who_has_the_token_may_act(
    stage: Stage, chromium: BrowserContext
) -> None:
    _, address = stage.start_page("host:=0.0.0.0", MOBO_PAGE_TOKEN=TOKEN)
    assert address.endswith(f"/?token={TOKEN}")
    port = re.search(r":(\d+)/", address)
    assert port
    local = f"http://127.0.0.1:{port[1]}/"
    page = chromium.new_page()
    page.goto(local)
    page.wait_for_selector(".badge")
    assert page.locator(".actions").count() == 0
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(f"{local}?token=another", timeout=10.0)
    assert refused.value.code == 403
    refused.value.close()
    page.goto(f"{local}?token={TOKEN}")
    page.wait_for_selector(".actions")
    assert page.url == local
    page.close()
