"""A run over two hosts, simulated by network namespaces, whose link is cut and restored during the run.

The machine is on one host; tuner, recorder and console are on the other. Only the link connects them. A second recorder
on the machine's host records its readbacks. Needs root and `ip` (Debian: iproute2). Prints whether the run ended, the
number of attempts of each evaluation, whether the journal is complete, and how far the machine moved after it had
detected the loss of the tuner. Exits with 1 after a fault, and with 77 if namespaces cannot be created.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore

from mobo_tuner.runs.mcap_records import read_messages

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT = 120.0  # [s] for the run
CLIENT_TIMEOUT = 2.0  # [s] after which the machine considers the tuner lost, and holds
REACTION = 1.0  # [s] allowed for its reaction
HOSTS = ("mobo-a", "mobo-b")
ENVIRONMENT = {
    "ROS_DOMAIN_ID": "77",
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
    "OMP_NUM_THREADS": "1",
}


def ip(*words: str) -> None:
    """Run the command `ip`."""
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


def make_hosts() -> None:
    """Create two namespaces and a link between them.

    Raises:
        OSError: If `ip` cannot be run.
        subprocess.CalledProcessError: If `ip` fails.
    """
    for host in HOSTS:
        ip("netns", "add", host)
    ends = ("veth0", "veth1")
    peer = ("peer", "name", ends[1], "netns", HOSTS[1])
    ip("link", "add", ends[0], "netns", HOSTS[0], "type", "veth", *peer)
    for number, (host, end) in enumerate(zip(HOSTS, ends, strict=True), start=1):
        ip("-n", host, "address", "add", f"10.77.0.{number}/24", "dev", end)
        for device in ("lo", end):
            ip("-n", host, "link", "set", device, "up")
        ip("-n", host, "route", "replace", "224.0.0.0/4", "dev", end)


def remove_hosts() -> None:
    """Remove the namespaces that exist."""
    for host in HOSTS:
        subprocess.run(["ip", "netns", "delete", host], check=False, capture_output=True)


def start(
    host: str, module: str, folder: Path, *given: str, namespace: str = "/"
) -> subprocess.Popen[bytes]:
    """Start a node on a host.

    Args:
        host: Name of the network namespace.
        module: Module of the node.
        folder: Folder of the log.
        given: Parameters as `name:=value`.
        namespace: ROS namespace of the node.
    """
    values = [word for value in given for word in ("-p", value)]
    values += ["-r", f"__ns:={namespace}"]
    config = ("--params-file", str(ROOT / "config" / "toy.yaml"))
    words = [sys.executable, "-m", module, "--ros-args", *config, *values]
    with (folder / f"{module}{namespace.strip('/')}.log").open("wb") as log:
        return subprocess.Popen(
            ["ip", "netns", "exec", host, *words],
            env={**os.environ, **ENVIRONMENT},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )


def evaluations(journal: Path) -> list[dict]:
    """Return the evaluations in a journal so far, without what belongs to their lines alone."""
    lines = journal.read_bytes().split(b"\n")[:-1] if journal.exists() else []
    records = [r for r in map(json.loads, lines) if r["type"] == "evaluation"]
    return [{k: v for k, v in r.items() if k not in ("line", "sum")} for r in records]


def readbacks(bag: Path, since: float, until: float) -> dict[str, list[float]]:
    """Return the readbacks on each plain topic between two times [s since the epoch]."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, list[float]] = {}
    for file in sorted(bag.glob("*.mcap")):
        for message in read_messages(file):
            if message.topic.endswith("/readback") and since < 1e-9 * message.time < until:
                content: Any = store.deserialize_cdr(message.data, "std_msgs/msg/Float64")
                found.setdefault(message.topic, []).append(content.data)
    return found


def carry_out(folder: Path, budget: int, cut: float) -> bool:
    """Carry out the run, and return whether there was no fault.

    Args:
        folder: Folder for runs, bags and logs.
        budget: Number of evaluations.
        cut: Time for which the link is cut [s].
    """
    journal = folder / "runs" / "run" / "journal.jsonl"
    here, there = HOSTS
    nodes = [
        start(there, "awa_sim_node.node", folder, "awa_sim:speed:=10.0"),
        start(
            here,
            "mobo_tuner.nodes.tuner",
            folder,
            f"tuner:runs_dir:={folder / 'runs'}",
            f"tuner:client_timeout:={CLIENT_TIMEOUT}",
            "tuner:machine_timeout:=2.0",
            "tuner:machine_return_timeout:=60.0",
        ),
        start(here, "mobo_tuner.nodes.recorder", folder, f"recorder:bag_path:={folder / 'bag'}"),
        start(
            there,
            "mobo_tuner.nodes.recorder",
            folder,
            f"bag_path:={folder / 'there'}",
            namespace="/there",
        ),
    ]
    given = ("console:run_id:=run", f"console:evaluations:={budget}")
    console = start(here, "mobo_tuner.nodes.console", folder, *given)
    nodes.append(console)
    try:
        deadline = time.monotonic() + TIMEOUT
        while len(evaluations(journal)) < budget // 3 and time.monotonic() < deadline:
            time.sleep(0.1)  # between two looks, until the deadline
        before = evaluations(journal)
        ip("-n", here, "link", "set", "veth0", "down")
        since = time.time() + CLIENT_TIMEOUT + REACTION
        time.sleep(cut)  # how long the link is down is what is tried
        until = time.time()
        during = evaluations(journal)
        ip("-n", here, "link", "set", "veth0", "up")
        # The kernel removes routes over a link that is down.
        ip("-n", here, "route", "replace", "224.0.0.0/4", "dev", "veth0")
        status = console.wait(max(1.0, deadline - time.monotonic()))
    except subprocess.TimeoutExpired:
        print(f"the run did not end within {TIMEOUT:g} s")
        return False
    finally:
        for node in nodes:
            node.terminate()
        for node in nodes:
            try:
                node.wait(10.0)
            except subprocess.TimeoutExpired:
                node.kill()
    told = evaluations(journal)
    print(
        f"cut for {cut:g} s after evaluation {len(before)}, {len(during) - len(before)} finished during "
        f"the cut; {len(told)} of {budget} at the end, attempts {[r['attempts'] for r in told]}; "
        f"exit status of the console {status}"
    )
    rests = readbacks(folder / "there", since, until)
    moved = {topic: max(values) - min(values) for topic, values in rests.items()}
    counts = [len(values) for values in rests.values()]
    print(f"in the last {until - since:.1f} s of the cut, {counts} readbacks moved by {moved}")
    still = bool(moved) and min(counts) >= 5 and not any(moved.values())
    whole = [record["index"] for record in told] == list(range(budget))
    return status == 0 and whole and told[: len(during)] == during and still


def main() -> int:
    """Create the hosts, and carry out the run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluations", type=int, default=12, help="number of evaluations")
    parser.add_argument("--cut", type=float, default=6.0, help="time for which the link is cut [s]")
    options = parser.parse_args()
    return try_out(
        make_hosts, remove_hosts, lambda folder: carry_out(folder, options.evaluations, options.cut)
    )


def try_out(
    make: Callable[[], None], remove: Callable[[], None], trial: Callable[[Path], bool]
) -> int:
    """Carry out a trial between hosts; return the exit status, 77 if hosts cannot be created here.

    Args:
        make: Creates the hosts.
        remove: Removes them as far as they are there.
        trial: Returns whether all was right, given a folder for its files.
    """
    remove()
    try:
        make()
    except (OSError, subprocess.CalledProcessError) as error:
        remove()
        print(f"network namespaces cannot be created: {getattr(error, 'stderr', error)}")
        return 77
    try:
        with tempfile.TemporaryDirectory() as folder:
            return 0 if trial(Path(folder)) else 1
    finally:
        remove()


if __name__ == "__main__":
    sys.exit(main())
