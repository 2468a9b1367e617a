"""The page: whatever the run was, well-formed, escaped, without outside addresses, and right."""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Callable, Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from mobo_tuner.runs.journal import append_record, journal_line, read_journal
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.records import ForgetRecord, to_json
from mobo_tuner.runs.report import plots
from mobo_tuner.runs.report.comparison import render_comparison
from mobo_tuner.runs.report.figures import front_figure, hypervolume_figure
from mobo_tuner.runs.report.models import model_facts
from mobo_tuner.runs.report.page import duration, failures, number, render_page
from mobo_tuner.runs.report.summary import summarize
from robustness.offline_run import OfflineRun, toy, toy_optimizer
from tests.support.run_folders import TWO, evaluation, seven_objectives, write_run

EVIL = "<script>alert('x')</script>"
VOID = {"meta", "link", "br"}
FAILED = {"valid": False, "feasible": False, "error_code": 3}


class Reader(HTMLParser):
    """Checks that every element is closed, and collects the text that a person reads."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.text: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.addresses += [
            value or "" for name, value in attrs if name in ("href", "src", "action")
        ]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text.append(data)


def read(folder: Path) -> str:
    """The text of a run's page, which is checked on the way."""
    page = render_page(RecordedRun.load(folder), folder)
    reader = Reader()
    reader.feed(page)
    assert reader.open == []
    assert all(a.startswith("#") or a == "data:," for a in reader.addresses)
    assert not re.search(r"https?:|@import|url\((?!#)|<script|\b(nan|inf)\b", page)
    assert "default-src 'none'" in html.unescape(page)
    for svg in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        ElementTree.fromstring(svg)
    return re.sub(r"\s+", " ", "".join(reader.text))


def single_objective(folder: Path) -> Path:
    problem = {"variables": TWO["variables"], "objectives": {"f1": {"reference": 10.0}}}
    records = [evaluation(i, {"f1": value}) for i, value in enumerate([7.0, 3.0, 5.0, 11.0])]
    return write_run(folder, records, problem)


def nothing_feasible(folder: Path) -> Path:
    records = [evaluation(i, {"f1": 5.0 + i, "f2": 1.0}, feasible=False) for i in range(6)]
    return write_run(folder, records)


def everything_failed(folder: Path) -> Path:
    return write_run(folder, [evaluation(i, {}, **FAILED) for i in range(3)])


def one_evaluation(folder: Path) -> Path:
    return write_run(folder, [evaluation(0, {"f1": 5.0, "f2": 5.0})])


def no_evaluation(folder: Path) -> Path:
    return write_run(folder, [])


def partly_measured(folder: Path) -> Path:
    values = [{"f1": 2.0 + i, "f2": math.nan if i % 2 else 7.0 - i} for i in range(5)]
    return write_run(folder, [evaluation(i, v) for i, v in enumerate(values)])


def spanning_decades(folder: Path) -> Path:
    variables = {"x": {"min": 1e-4, "max": 1.0, "scale": "log"}}
    problem = TWO | {"variables": variables, "constraints": {}}
    values = [{"f1": 10.0 ** (2 - i), "f2": 10.0 ** (i - 8)} for i in range(10)]
    setpoints = [{"x": 10.0 ** (-0.4 * i)} for i in range(10)]
    made = [
        evaluation(i, v, setpoint=s) for i, (v, s) in enumerate(zip(values, setpoints, strict=True))
    ]
    return write_run(folder, made, problem)


def never_measured(folder: Path) -> Path:
    return write_run(folder, [evaluation(i, {"f1": 2.0 + i}, feasible=False) for i in range(5)])


def reference_left_out(folder: Path) -> Path:
    problem = {"variables": TWO["variables"], "objectives": {"f1": {"reference": 10.0}, "f2": {}}}
    return write_run(folder, [evaluation(i, {"f1": 2.0, "f2": 3.0}) for i in range(2)], problem)


@pytest.fixture(scope="module")
def changed_and_resumed(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The text of its page; seed 7 has failures, an operator's set-points and two changes."""
    folder = tmp_path_factory.mktemp("changed") / "run"
    run = OfflineRun(folder, toy_optimizer(7), toy, 7)
    for _ in range(14):
        run.step()
    run.log.close()
    path = folder / "journal.jsonl"
    start, *rest = read_journal(folder)
    start["resumed_from"] = {"run_id": "earlier", "evaluations": 5}
    path.write_bytes(b"".join(journal_line(record) for record in (start, *rest)))
    return read(folder)


TITLES = ("Recommended points", "Convergence", "Fronts", "Models", "Reproduce")


@pytest.mark.parametrize(
    "make",
    [
        single_objective,
        nothing_feasible,
        everything_failed,
        one_evaluation,
        no_evaluation,
        partly_measured,
        never_measured,
        spanning_decades,
        reference_left_out,
        lambda folder: seven_objectives(folder, 1),
        lambda folder: seven_objectives(folder, 40),
    ],
)
def test_every_run_has_a_page(make: Callable[[Path], Path], tmp_path: Path) -> None:
    text = read(make(tmp_path / "run"))
    assert all(title in text for title in TITLES)


def test_what_spans_decades_has_logarithmic_axes(tmp_path: Path) -> None:
    run = RecordedRun.load(spanning_decades(tmp_path / "run"))
    (front,), (trace,) = plots.fronts(run, []), plots.trajectories(run)
    assert (front.x.log, front.y.log, trace.y.log) == (True, True, True)
    assert [axis.log for axis in plots.parallel_coordinates(run, []).axes] == [True] * 3
    compared = render_comparison([run, run])
    assert ">10⁻⁵</text>" in compared


def test_the_summary_in_words(mixed: Path) -> None:
    text = read(mixed)
    assert "The run made 8 evaluations in 17 min" in text
    assert "6 evaluations met every constraint, 1 failed, and 1 broke a constraint" in text
    assert "The Pareto front has 3 points" in text


@pytest.fixture(params=[2, 1])
def of_two_fidelities(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A run with one or two objectives, three evaluations with a coarse mesh and two with a fine one."""
    problem = {**TWO, "fidelity": {"mesh": {"choices": [8, 24]}, "cost": "mesh ** 2 / 576"}}
    values = {"f1": 5.0, "f2": 5.0}
    names = list(values)[: request.param]
    problem["objectives"] = {name: problem["objectives"][name] for name in names}
    made = [
        evaluation(
            i,
            values,
            setpoint={"x1": 0.5 * i, "mesh": mesh},
            feasible=mesh == 24.0,
        )
        for i, mesh in enumerate((8.0, 8.0, 8.0, 24.0, 24.0))
    ]
    return write_run(tmp_path / "run1", made, problem, {"stop_reason": "budget"})


def test_cheaper_evaluations_have_marks_of_their_own(of_two_fidelities: Path) -> None:
    run = RecordedRun.load(of_two_fidelities)
    drawn = [plots.convergence(run), *plots.fronts(run, [])]
    legends = [{text for text, *_ in plot.legend} for plot in drawn]
    figures = [front_figure(run), hypervolume_figure(run)]
    legends += [set(figure.axes[0].get_legend_handles_labels()[1]) for figure in figures]
    for legend in legends:
        assert "lower fidelity" in legend
        assert "infeasible" not in legend


def test_what_each_fidelity_cost_is_told_and_a_cheaper_evaluation_breaks_no_constraint(
    of_two_fidelities: Path,
) -> None:
    folder = of_two_fidelities
    text = read(folder)
    assert "cost as much as 2.33 evaluations" in text
    assert "3 evaluations with mesh 8 (0.333), 2 evaluations with mesh 24 (2)" in text
    assert "2 evaluations met every constraint, 0 failed, and 0 broke a constraint" in text
    fidelities = summarize(RecordedRun.load(folder))["fidelities"]
    assert [each["level"] for each in fidelities] == [{"mesh": 8.0}, {"mesh": 24.0}]
    assert [each["evaluations"] for each in fidelities] == [3, 2]


def test_a_withdrawn_evaluation_is_neither_failed_nor_on_the_front(mixed: Path) -> None:
    append_record(mixed, to_json(ForgetRecord(3000.0, 8, 2, withdrawn=True)))
    text = read(mixed)
    assert "5 evaluations met every constraint, 1 failed, and 1 broke a constraint" in text
    assert "withdrew 1 evaluation" in text
    assert "The Pareto front has 2 points" in text


def test_an_empty_front_is_explained(tmp_path: Path) -> None:
    text = read(nothing_feasible(tmp_path))
    assert "There is no point to recommend" in text
    assert "f2" in text


def test_changes_and_the_run_that_is_resumed_are_told(changed_and_resumed: str) -> None:
    text = changed_and_resumed
    assert all(title in text for title in TITLES)
    assert "This run resumes earlier, after 5 evaluations" in text
    assert "problem or budget changed" in text
    assert re.search(r"variables\.x1\.max: 2\.0 → [0-9.]+", text)


def test_nothing_that_comes_from_a_file_or_a_machine_is_taken_for_html(tmp_path: Path) -> None:
    problem = {
        "variables": {"x1": {"min": 0.0, "max": 4.0, "unit": EVIL}},
        "objectives": {"f1": {"reference": 10.0, "unit": EVIL}, "f2": {"reference": 10.0}},
        "constraints": {"g": {"max": 9.0, "unit": EVIL}},
    }
    records: list[dict[str, Any]] = [
        evaluation(i, {"f1": 2.0 + i, "f2": 7.0 - i, "g": 1.0, EVIL: 1.0}) for i in range(4)
    ]
    records.append(evaluation(4, {}, **FAILED, error_msg=EVIL))
    folder = write_run(tmp_path, records, problem, {"stop_reason": EVIL, "error_msg": EVIL})
    (folder / "config.yaml").write_text(f"a: {EVIL}\n")
    facts = {"versions": {EVIL: EVIL}, "arguments": {"config": EVIL}}
    (folder / "run.json").write_text(json.dumps(facts))
    assert read(folder).count(EVIL) >= 10


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe", b'{"versions": 3}'])
def test_a_broken_run_file_is_left_out(mixed: Path, content: bytes) -> None:
    (mixed / "run.json").write_bytes(content)
    assert "Versions" not in read(mixed)


def test_failures_are_grouped_by_their_cause(tmp_path: Path) -> None:
    messages = ["the beam was lost", "", "the beam was lost"]
    records = [evaluation(i, {}, **FAILED, error_msg=m) for i, m in enumerate(messages)]
    found = failures(RecordedRun.load(write_run(tmp_path, records)))
    assert [(f.times, f.indices) for f in found] == [(2, "0, 2"), (1, "1")]
    assert found[0].cause == "the beam was lost"


def test_the_models_are_in_the_outputs_own_sense_and_units(tmp_path: Path) -> None:
    """A maximised linear output: the second variable drives it alone, and all is predicted well."""
    problem = {
        "variables": {"x1": {"min": 0.0, "max": 1.0}, "x2": {"min": 0.0, "max": 10.0}},
        "objectives": {"gain": {"reference": 0.0, "direction": "maximize", "unit": "nC"}},
    }
    points = np.random.default_rng(2).random((15, 2)) * [1.0, 10.0]
    records = [
        evaluation(i, {"gain": 3.0 + y}, setpoint={"x1": x, "x2": y})
        for i, (x, y) in enumerate(points.tolist())
    ]
    (fact,) = model_facts(RecordedRun.load(write_run(tmp_path, records, problem)))
    np.testing.assert_allclose(fact.measured, 3.0 + points[:, 1], rtol=1e-6)
    assert fact.unit == "nC"
    assert fact.skill > 0.95
    assert fact.error == pytest.approx(np.std(fact.measured) * math.sqrt(1.0 - fact.skill))
    assert fact.indices[1] > 0.95
    assert fact.indices[0] < 0.05
    assert fact.length_scales[1] > 1.0


def test_a_page_stays_light(tmp_path: Path) -> None:
    """The worst case: all points of a run in seven objectives are on the front."""
    count = 120
    folder = seven_objectives(tmp_path, count)
    size = len(render_page(RecordedRun.load(folder), folder).encode())
    assert size < count * 5e6 / 500


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (-1.5, "−1.5"), (12345.678, "1.235×10⁴"), (math.nan, "–"), (None, "–")],
)
def test_numbers(value: float | None, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("seconds", "text"), [(1.25, "1.2 s"), (600.0, "10 min"), (9000.0, "2.5 h"), (math.nan, "–")]
)
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text
