"""What a run puts on the network, topic by topic, from its bag: messages and bytes per evaluation and per second.

Bytes are those of the serialised messages. What DDS adds, about 100 bytes for each message and reader, is not counted,
nor are the actions and services, which no bag holds.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

from rosbags.rosbag2 import Reader


def main() -> None:
    """Read a bag and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path, help="folder of a bag")
    options = parser.parse_args()
    sizes: dict[str, list[int]] = defaultdict(list)
    with Reader(options.bag) as reader:
        seconds = reader.duration * 1e-9
        for connection, _, data in reader.messages():
            sizes[connection.topic].append(len(data))
    evaluations = len(sizes["/evaluation"])
    plots = [topic for topic in sizes if topic.startswith("/plot/")]
    sizes["/plot/*"] = [size for topic in plots for size in sizes.pop(topic)]
    print(f"{evaluations} evaluations in {seconds:.0f} s")
    print(
        f"{'topic':24}{'messages':>10}{'mean [B]':>10}{'largest [B]':>13}{'per evaluation [B]':>20}{'[B/s]':>10}"
    )
    for topic, of_topic in sorted(sizes.items(), key=lambda item: -sum(item[1])):
        if not of_topic:
            continue
        total = sum(of_topic)
        print(
            f"{topic:24}{len(of_topic):10}{total / len(of_topic):10.0f}{max(of_topic):13}"
            f"{total / max(evaluations, 1):20.0f}{total / seconds:10.0f}"
        )


if __name__ == "__main__":
    main()
