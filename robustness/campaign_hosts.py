"""A campaign over three hosts, simulated by network namespaces: workers are lost, links are cut, others join.

The manager is on one host; on each of two others there are two workers, and only a link to the manager's host. After a
third of the evaluations all workers of the first host are killed, and one link is cut for some seconds and restored.
After two thirds, two new workers join on the first host. Needs root and `ip` (Debian: iproute2). Prints the number of
evaluations of each host and whether one was lost or counted as failed. Exits with 1 after a fault, and with 77 if
namespaces cannot be created.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import yaml

from mobo_tuner.offline.hosts import FILE_NAME
from robustness.two_hosts import evaluations, ip, try_out

TIMEOUT = 240.0  # [s] for the campaign
MANAGER, HOSTS = "mobo-m", ("mobo-1", "mobo-2")
ADDRESS = "10.78.1.1"  # of the manager
PROGRAM = """
import json, math, os, random, sys, time
x = json.load(sys.stdin)
time.sleep(random.uniform(0.1, 0.6))  # the duration of a simulation
with open("host", "w") as file:
    file.write(os.environ["MOBO_HOST"])
print(json.dumps({"f1": math.hypot(x["x1"] - 1, x["x2"] - 1), "f2": math.hypot(x["x1"] + 1, x["x2"] + 1)}))
"""


def make_hosts() -> None:
    """Create the namespaces, and a link from the manager's to each other one.

    Raises:
        OSError: If `ip` cannot be run.
        subprocess.CalledProcessError: If `ip` fails.
    """
    for host in (MANAGER, *HOSTS):
        ip("netns", "add", host)
        ip("-n", host, "link", "set", "lo", "up")
    for i, host in enumerate(HOSTS, start=1):
        ends = (f"veth{i}", "veth0")
        ip("link", "add", ends[0], "netns", MANAGER, "type", "veth", "peer", ends[1], "netns", host)
        for number, (where, end) in enumerate(((MANAGER, ends[0]), (host, ends[1])), start=1):
            ip("-n", where, "address", "add", f"10.78.{i}.{number}/24", "dev", end)
            ip("-n", where, "link", "set", end, "up")
        ip("-n", host, "route", "add", "default", "via", f"10.78.{i}.1")


def remove_hosts() -> None:
    """Remove the namespaces that exist."""
    for host in (MANAGER, *HOSTS):
        subprocess.run(["ip", "netns", "delete", host], check=False, capture_output=True)


def start(host: str, module: str, *arguments: object) -> subprocess.Popen[bytes]:
    """Start a module on a host; `ip netns exec` becomes it, so that a signal reaches it."""
    words = ["ip", "netns", "exec", host, sys.executable, "-m", module, *map(str, arguments)]
    return subprocess.Popen(
        words,
        env={**os.environ, "OMP_NUM_THREADS": "1", "MOBO_HOST": host},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )


def wait_for(journal: Path, count: int, deadline: float) -> list[dict[str, Any]]:
    """Return the evaluations of the journal once there are so many, or at the deadline."""
    while len(found := evaluations(journal)) < count and time.monotonic() < deadline:
        time.sleep(0.05)  # between two looks, until the deadline
    return found


def carry_out(folder: Path, budget: int, cut: float) -> bool:
    """Carry out a campaign; return whether nothing was lost and both hosts worked.

    Args:
        folder: Folder of the files.
        budget: Number of evaluations.
        cut: Time for which the link of the second host is cut [s].
    """
    run, journal = folder / "run", folder / "run" / "journal.jsonl"
    (folder / "program.py").write_text(PROGRAM)
    bounds = {"min": -2.0, "max": 2.0}
    sections = {
        "/**": {
            "variables": {"x1": bounds, "x2": bounds},
            "objectives": {"f1": {"reference": 4.3}, "f2": {"reference": 4.3}},
        },
        "tuner": {"evaluations": budget},
        "campaign": {"command": f"python {folder / 'program.py'}", "workers": 4, "timeout": 30.0},
    }
    content = {name: {"ros__parameters": section} for name, section in sections.items()}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    config = ("--config", folder / "campaign.yaml", "--listen", ADDRESS)
    worker = ("mobo_tuner.offline.worker", run, "--patience", 60)
    deadline = time.monotonic() + TIMEOUT
    manager = start(MANAGER, "mobo_tuner.offline.campaign", run, *config)
    processes = [manager] + [start(host, *worker) for host in HOSTS for _ in range(2)]
    try:
        wait_for(journal, budget // 3, deadline)
        for lost in processes[1:3]:
            lost.kill()
        ip("-n", MANAGER, "link", "set", "veth2", "down")
        time.sleep(cut)  # how long the link is down is what is tried
        ip("-n", MANAGER, "link", "set", "veth2", "up")
        wait_for(journal, 2 * budget // 3, deadline)
        processes += [start(HOSTS[0], *worker) for _ in range(2)]
        status = manager.wait(max(1.0, deadline - time.monotonic()))
        ends = [each.wait(60.0) for each in processes[3:]]
    except subprocess.TimeoutExpired:
        print(f"the campaign did not end within {TIMEOUT:g} s")
        return False
    finally:
        for each in processes:
            each.kill()
            each.wait()
    told = evaluations(journal)
    hosts = [path.read_text() for path in run.glob("simulations/*/host")]
    counts = {host: hosts.count(host) for host in HOSTS}
    failed = [record["error_msg"] for record in told if not record["valid"]]
    print(
        f"{len(told)} of {budget} evaluations, {counts}, {len(failed)} failed {set(failed) or ''}; "
        f"exit status {status}, those of the workers that were not killed {ends}"
    )
    whole = [record["index"] for record in told] == list(range(budget))
    gone = not (run / FILE_NAME).exists() and not any(ends)
    return status == 0 and whole and not failed and gone and min(counts.values()) >= budget // 6


def main() -> int:
    """Create the hosts, and carry out the campaign."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluations", type=int, default=60, help="number of evaluations")
    parser.add_argument("--cut", type=float, default=5.0, help="time for which a link is cut [s]")
    options = parser.parse_args()
    return try_out(
        make_hosts, remove_hosts, lambda folder: carry_out(folder, options.evaluations, options.cut)
    )


if __name__ == "__main__":
    sys.exit(main())
