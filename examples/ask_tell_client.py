"""Own the loop: ask the tuner where to measure, measure by yourself, tell it what was measured.

There is no machine node: this program is the machine, and plays the paper's toy problem. A tuner with
config/toy.yaml must be running in the ROS domain of the environment:

    python examples/ask_tell_client.py 20
"""

import math
import sys
from collections.abc import Mapping

from mobo_tuner.client import TunerClient, TunerError


def measure(x: Mapping[str, float]) -> dict[str, float]:
    """Go to a set-point and measure there; put in your own machine."""
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
    }


def main() -> None:
    """Ask, measure and tell, and print the front at the end."""
    evaluations = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    try:
        with TunerClient(timeout=30.0) as client:
            for _ in range(evaluations):
                suggestion = client.ask()
                evaluation = client.tell(suggestion, measure(suggestion.setpoint))
                print(f"{evaluation.index}: hypervolume {evaluation.hypervolume:.5g}")
            front = client.working_points(suggestion.run_id).measured
    except TunerError as error:
        sys.exit(str(error))
    for point in front.points:
        print(", ".join(f"{name} = {value:.4g}" for name, value in point.objectives.items()))


if __name__ == "__main__":
    main()
