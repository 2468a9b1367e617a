"""Start a run from your own program, with the client that this suite brings.

The tuner and a machine must be running in the ROS domain of the environment:

    python examples/tune_client.py 20

Ctrl-C cancels the run; the machine goes where `on_abort` says.
"""

import sys

from mobo_tuner.client import Evaluation, TunerClient, TunerError


def show(evaluation: Evaluation) -> None:
    """Print an evaluation."""
    values = ", ".join(
        f"{name} = {value:.4g} {evaluation.units.get(name, '')}".rstrip()
        for name, value in evaluation.objectives.items()
    )
    print(f"{evaluation.index}: {values}; hypervolume {evaluation.hypervolume:.5g}")


def main() -> None:
    """Ask for a run and print the front at the end."""
    evaluations = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    try:
        with TunerClient(timeout=30.0) as client:
            result = client.tune(evaluations=evaluations, on_evaluation=show)
    except TunerError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit("the run was canceled")
    print(f"{result.evaluations} evaluations, {len(result.front.points)} on the front")
    print(f"stopped by {result.stop_reason}", f"({result.error})" if result.error else "")


if __name__ == "__main__":
    main()
