"""Measure the size of a run's bag: 1000 evaluations in seven objectives, nearly all of them on the front.

The messages are those that the tuner publishes, made without any node and without the time that a run
takes; set-points and readings are random. The front is published as often as the tuner does it and, for
comparison, after every evaluation.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from mobo_msgs_py import msg
from mobo_tuner.core import Problem
from mobo_tuner.core.pareto import is_nondominated
from mobo_tuner.runs.bag import BagWriter
from mobo_tuner.runs.definitions import find_definition
from mobo_tuner.runs.records import EvaluationRecord
from mobo_tuner.tuner.messages import evaluation_message, front_message
from mobo_tuner.tuner.topics import TunerTopics

AWA = Path(__file__).parents[1] / "config" / "awa.yaml"
STATUSES = 4  # status messages in an evaluation's time
TICK = 1_000_000  # [ns] between two messages
START = 1_700_000_000_000_000_000  # [ns]


def messages(
    problem: Problem, evaluations: int, topics: TunerTopics | None
) -> Iterator[tuple[str, Any]]:
    """Yield the messages of a run with their topics.

    Args:
        problem: Problem of the run.
        evaluations: Number of evaluations.
        topics: Topics that decide when a front is published; None for every change.
    """
    rng = np.random.default_rng(0)
    names = problem.objective_names
    values = rng.uniform(0.0, 1.0, (evaluations, len(names)))
    setpoints = rng.uniform(0.0, 1.0, (evaluations, len(problem.variable_names)))
    points: list[dict[str, Any]] = [
        {
            "index": index,
            "setpoint": dict(zip(problem.variable_names, setpoints[index], strict=True)),
            "objectives": dict(zip(names, values[index], strict=True)),
            "stddevs": dict.fromkeys(names, 0.1),
        }
        for index in range(evaluations)
    ]
    made: list[msg.ParetoFront] = []
    for index, point in enumerate(points):
        record = EvaluationRecord(
            index=index,
            source="model",
            attempts=1,
            stamp=1.0,
            setpoint=point["setpoint"],
            readbacks=point["setpoint"],
            diagnostics={name: (value, 0.1) for name, value in point["objectives"].items()},
            valid=True,
            feasible=True,
            non_dominated=True,
            hypervolume=1.0,
            hypervolume_measured=1.0,
            error_code=0,
            error_msg="",
            suggest_seconds=0.1,
            machine_seconds=0.1,
            total_seconds=0.2,
        )
        message = evaluation_message(problem, record, "run")
        yield "/evaluation", message
        yield "/latest_evaluation", message
        for name in (*names, *problem.variable_names, "hypervolume", "suggest_seconds"):
            yield f"/plot/{name}", Float64()
        for _ in range(STATUSES):
            yield "/status", msg.TunerStatus(run_id="run")
        kept = np.flatnonzero(is_nondominated(values[: index + 1]))
        front = [points[i] for i in kept]

        def make(front: list[Any] = front) -> msg.ParetoFront:
            made.append(front_message(problem, front, (1.0, math.nan), "run", Time()))
            return made[-1]

        if topics is None:
            make()
        else:
            topics.front_changed(kept.tolist(), make)
        while made:
            yield "/pareto_front", made.pop()


def write(bag: Path, problem: Problem, evaluations: int, topics: TunerTopics | None) -> int:
    """Write a bag, print its largest topics, and return its size [byte]."""
    writer = BagWriter(bag)
    writer.open()
    connections: dict[str, Any] = {}
    sizes: Counter[str] = Counter()
    time = START
    for topic, message in messages(problem, evaluations, topics):
        kind = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
        if topic not in connections:
            definition = find_definition(kind)
            connections[topic] = writer.add_connection(
                topic, kind, msgdef=definition.text, rihs01=definition.type_hash
            )
        data = serialize_message(message)
        sizes["/plot" if topic.startswith("/plot") else topic] += len(data)
        time += TICK
        writer.write(connections[topic], time, data)
    writer.close()
    for topic, size in sizes.most_common():
        print(f"  {topic:<20} {size / 1e6:8.2f} MB")
    return sum(file.stat().st_size for file in bag.iterdir())


def main() -> None:
    """Write both bags and print their sizes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluations", type=int, default=1000, metavar="N")
    options = parser.parse_args()
    problem = Problem.from_yaml(AWA)
    rclpy.init()
    node = rclpy.create_node("bag_size")
    with tempfile.TemporaryDirectory() as folder:
        for name, topics in (
            ("fronts as the tuner publishes them", TunerTopics(node, problem, 0.0)),
            ("a front after every evaluation", None),
        ):
            print(f"{name}:")
            size = write(
                Path(folder) / name.replace(" ", "-"), problem, options.evaluations, topics
            )
            print(f"  the bag              {size / 1e6:8.2f} MB")
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
