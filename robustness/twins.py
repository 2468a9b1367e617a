"""A campaign whose points are evaluated by several simulated machines, each in a namespace of its own.

Every machine is slow: what is measured is how much faster several are than one. With several, one is killed (SIGKILL)
in mid-run; the others continue, its point is evaluated by another one, and it is started and joins again. Then the
manager is killed, and the campaign is resumed for some more evaluations by the same machines. Prints the times and
what was lost. Exits with 1 if an evaluation was lost or failed, or a worker did not end.

    python -m robustness.twins --machines 4
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import yaml

from robustness.processes import NodeProcess, NodeStarter
from robustness.two_hosts import evaluations

TIMEOUT = 120.0  # [s] for each wait
DOMAIN = "79"
_ENOUGH = 10_000  # evaluations, until the manager is killed
_BOUNDS = {"min": -2.0, "max": 2.0}


class Stands:
    """Machines, their workers and the campaigns of a folder.

    Args:
        folder: Folder.
        speed: Speed of the simulated machines.
        domain: Domain of the nodes.
    """

    def __init__(self, folder: Path, speed: float, domain: str) -> None:
        self.folder = folder
        self._start = NodeStarter(folder)
        self._speed = speed
        self._domain = domain
        sections = {
            "/**": {
                "variables": {"x1": _BOUNDS, "x2": _BOUNDS},
                "objectives": {"f1": {"reference": 4.3}, "f2": {"reference": 4.3}},
            },
            "campaign": {"timeout": 60.0},
        }
        content = {name: {"ros__parameters": section} for name, section in sections.items()}
        (folder / "campaign.yaml").write_text(yaml.safe_dump(content))

    def machine(self, number: int) -> NodeProcess:
        """Start a machine, whose namespace is its number."""
        settings = (
            "model:=toy",
            "mode:=ideal",
            "beam_repetition_rate:=0.01",
            f"speed:={self._speed}",
        )
        given = [word for setting in settings for word in ("-p", setting)]
        return self._node(number, ["awa_sim_node.node"], *given)

    def worker(self, number: int, run: str) -> NodeProcess:
        """Start the worker of a machine for a run."""
        return self._node(number, ["mobo_tuner.nodes.twin", str(self.folder / run)])

    def campaign(self, run: str, *arguments: object) -> NodeProcess:
        """Start a campaign."""
        words = map(str, (self.folder / run, "--listen", "127.0.0.1", *arguments))
        return self._start(
            "-m",
            "mobo_tuner.offline.campaign",
            *words,
            OMP_NUM_THREADS="1",
            ROS_DOMAIN_ID=self._domain,
        )

    def _node(self, number: int, program: list[str], *given: str) -> NodeProcess:
        names = ("--ros-args", "-r", f"__ns:=/stand_{number}")
        return self._start(
            "-m", *program, *names, *given, OMP_NUM_THREADS="1", ROS_DOMAIN_ID=self._domain
        )

    def made(self, run: str) -> int:
        """Return the number of evaluations in the journal of a run."""
        return len(evaluations(self.folder / run / "journal.jsonl"))

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for something.

        Raises:
            TimeoutError: If it does not come.
        """
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"waited {TIMEOUT:g} s in vain for {what}")
            time.sleep(0.05)  # between two looks, until the deadline

    def close(self) -> None:
        """End all processes."""
        for process in self._start.processes:
            process.kill()


def time_of(stands: Stands, machines: int, budget: int) -> float:
    """Return the time of a campaign from its second evaluation to its end [s], without any fault."""
    run = f"timed-{machines}"
    config = ("--config", stands.folder / "campaign.yaml", "--workers", machines)
    campaign = stands.campaign(run, *config, "--evaluations", budget)
    workers = [stands.worker(number, run) for number in range(machines)]
    stands.wait_for(lambda: stands.made(run) >= machines, "all workers")
    begun, made = time.monotonic(), stands.made(run)
    assert campaign.wait(TIMEOUT) == 0, campaign.stderr
    seconds = time.monotonic() - begun
    assert not any(worker.wait() for worker in workers)
    return seconds / (budget - made)


def with_faults(stands: Stands, machines: list[NodeProcess], budget: int) -> bool:
    """Kill a machine and the manager; return whether nothing was lost.

    Args:
        stands: Machines, workers and campaigns.
        machines: Machines that run.
        budget: Number of evaluations at the end.
    """
    count = len(machines)
    config = ("--config", stands.folder / "campaign.yaml", "--workers", count)
    campaign = stands.campaign("first", *config, "--evaluations", _ENOUGH)
    workers = [stands.worker(number, "first") for number in range(count)]
    stands.wait_for(lambda: all("joined" in each.stderr for each in workers), "all workers")
    made = stands.made("first")
    stands.wait_for(lambda: stands.made("first") >= made + budget // 3, "evaluations")
    machines[0].kill()
    stands.wait_for(lambda: "given back" in workers[0].stderr, "the loss of a machine")
    made = stands.made("first")
    stands.wait_for(lambda: stands.made("first") >= made + budget // 6, "the other machines")
    machines[0] = stands.machine(0)
    stands.wait_for(lambda: workers[0].stderr.count("joined") == 2, "the return of a machine")
    campaign.kill()
    before = evaluations(stands.folder / "first" / "journal.jsonl")
    (stands.folder / "first" / "workers.json").unlink()  # so that nobody waits for who was killed
    budget = max(budget, len(before) + count)
    campaign = stands.campaign(
        "second", "--resume", stands.folder / "first", "--evaluations", budget
    )
    again = [stands.worker(number, "second") for number in range(count)]
    status = campaign.wait(TIMEOUT)
    told = evaluations(stands.folder / "second" / "journal.jsonl")
    ends = [worker.wait() for worker in (*workers, *again)]
    failed = [record["error_msg"] for record in told if not record["valid"]]
    print(
        f"{len(told)} of {budget} evaluations, {len(before)} before the manager was killed, "
        f"{len(failed)} failed {set(failed) or ''}; exit status {status}, of the workers {ends}"
    )
    whole = [record["index"] for record in told] == list(range(budget))
    return status == 0 and whole and told[: len(before)] == before and not failed and not any(ends)


def main() -> int:
    """Carry out the campaigns."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machines", type=int, default=4, help="number of machines")
    parser.add_argument("--evaluations", type=int, default=24, help="number of evaluations")
    parser.add_argument("--speed", type=float, default=80.0, help="100 / time of a shot [s]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        stands = Stands(Path(folder), options.speed, DOMAIN)
        try:
            machines = [stands.machine(number) for number in range(options.machines)]
            one = time_of(stands, 1, options.evaluations // 2)
            many = time_of(stands, options.machines, options.evaluations)
            print(
                f"{one:.2f} s an evaluation with one machine, {many:.2f} s with {options.machines}: "
                f"{one / many:.2f} times faster; load {os.getloadavg()[0]:.1f}"
            )
            return 0 if with_faults(stands, machines, options.evaluations) else 1
        except (TimeoutError, AssertionError) as error:
            print(error)
            return 1
        finally:
            stands.close()


if __name__ == "__main__":
    sys.exit(main())
