"""A run of `mobo.py run` is steered by the verbs of `mobo.py`, which find it by its folder."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable

from tests.support.mobo_run import ROOT, Run


def test_a_run_is_steered_from_another_terminal(start: Callable[..., Run]) -> None:
    run = start("--evaluations", "1000", "--seed", "4")

    def mobo(*words: str, status: int = 0) -> str:
        done = subprocess.run(
            [sys.executable, str(ROOT / "mobo.py"), *words, "--runs-dir", str(run.runs_dir)],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == status, done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout or done.stderr

    run.until(lambda: len(run.evaluations()) > 2, "evaluations")
    mobo("pause")
    paused = "paused; run run: "
    run.until(lambda: mobo("status").startswith(paused), "the pause", period=0.3)
    before = len(run.evaluations())
    mobo("queue", "x1=0.5", "x2=-0.1")
    mobo("set", "variables.x1.max=1.5", "objectives.f1.truncation=[0,5.5]", "evaluations=900")
    assert "x1.max is 9" in mobo("set", "variables.x1.max=9", status=1)
    mobo("step")
    run.until(lambda: len(run.evaluations()) == before + 1, "the step")
    assert run.evaluations()[-1]["setpoint"] == {"x1": 0.5, "x2": -0.1}
    listed = mobo("points", "--top", "1", "--sort", "f1").splitlines()
    assert re.match(r"1 (of \d+ )?points of run run, measured", listed[0])
    assert "run 'run'" in mobo("go", listed[2].split()[0], status=1)
    mobo("continue")
    run.until(lambda: len(run.evaluations()) > before + 3, "more evaluations")
    mobo("stop")
    status, out, err = run.wait()
    assert status == 0, err
    summary = json.loads((run.folder / "summary.json").read_text())
    assert summary["stop_reason"] == "stopped"
    printed = re.findall(r"^evaluation +(\d+),", out, re.MULTILINE)
    assert [int(i) for i in printed] == [e["index"] for e in run.evaluations()]
    assert "ROS_DOMAIN_ID" in mobo("status", status=2)
