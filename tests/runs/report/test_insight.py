"""What the models of a run say, as the page gets it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mobo_tuner.core.problem import Variable
from mobo_tuner.page import chart_parts, model_charts
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.report.insight import main
from mobo_tuner.runs.report.page import render_page
from tests.support.run_folders import evaluation, write_run


def told(folder: Path, *arguments: str, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    assert main([str(folder), *arguments]) == 0
    content = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert isinstance(content, dict)
    return content


def test_slices_drivers_and_predictions_are_told_and_drawn(
    mixed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = told(mixed, "--index", "2", capsys=capsys)
    assert (content["evaluations"], content["index"]) == (8, 2)
    outputs = content["outputs"]
    assert isinstance(outputs, list)
    assert [output["name"] for output in outputs] == ["f1", "f2"]
    slices = content["slices"]
    assert isinstance(slices, dict)
    for name, part in slices.items():
        lengths = {len(part["values"]), len(part["acquisition"])}
        lengths |= {len(values) for values in part["means"].values()}
        assert lengths == {61}
        assert name in outputs[0]["drivers"]
    gains = [a for part in slices.values() for a in part["acquisition"] if a is not None]
    assert not gains or max(gains) == 1.0
    for colours in (chart_parts.DARK, chart_parts.LIGHT):
        plots = [model_charts.drivers(outputs, colours)]
        plots += [model_charts.left_out(output, colours) for output in outputs]
        variables = [Variable(name, 0.0, 1.0, "A") for name in slices]
        plots += [model_charts.model_slice(content, v, "f1", colours) for v in variables]
        json.dumps(plots, allow_nan=False)
    assert "%" in model_charts.quality(outputs[0])


def test_readings_that_differ_by_their_noise_alone_are_not_called_badly_predicted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(3)
    problem = {
        "variables": {"x1": {"min": 0.0, "max": 4.0}},
        "objectives": {"f1": {"reference": 10.0}},
        "constraints": {"transmission": {"min": 0.98}, "loss": {"max": 1.0}},
    }
    records = []
    for i, x in enumerate(rng.uniform(0.0, 4.0, 20).tolist()):
        known = {"f1": [x * x, 0.01], "transmission": [rng.normal(1.0, 0.001), 0.001]}
        known["loss"] = [rng.normal(0.5, 0.01), None]
        records.append(evaluation(i, {}, setpoint={"x1": x}, diagnostics=known))
    folder = write_run(tmp_path / "run", records, problem)
    content = told(folder, capsys=capsys)
    outputs = content["outputs"]
    assert isinstance(outputs, list)
    assert [o["name"] for o in outputs if o["is_noise"]] == ["transmission"]
    assert "nothing to predict" in model_charts.quality(outputs[1])
    drawn = model_charts.drivers(outputs, chart_parts.DARK)["yAxis"][0]["data"]
    assert "transmission" not in drawn
    page = render_page(RecordedRun.load(folder), folder)
    assert "readings of transmission differ by no more than their noise" in page
    assert "do not predict" not in page


def test_a_run_without_readings_has_no_models(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(tmp_path / "short", [evaluation(0, {"f1": 1.0, "f2": 2.0})])
    content = told(folder, capsys=capsys)
    assert (content["outputs"], content["slices"]) == ([], {})
    assert main([str(folder), "--index", "7"]) == 1
    assert "the index is 7" in capsys.readouterr().err
    assert main([str(tmp_path)]) == 1
