"""A Python function as the command of a simulation.

`python -m mobo_tuner.offline.function FILE.py:FUNCTION` reads a point as one JSON object from standard input, calls
the function with it, and prints the outputs that it returns as another; with `--check` it only imports the function.
"""

from __future__ import annotations

import json
import math
import sys
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path

from mobo_tuner.errors import UserError
from mobo_tuner.python_functions import load_function


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate one point; return the exit status."""
    place, *check = sys.argv[1:] if arguments is None else arguments
    module, _, name = place.rpartition(":")
    if module.endswith(".py"):  # which may import its neighbours, as if it were started itself
        sys.path.insert(0, str(Path(module).parent))
    try:
        function = load_function(module, name)
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    if check:
        return 0
    try:
        outputs = function(json.loads(sys.stdin.readline()))
    except Exception as error:
        traceback.print_exc()
        if "\n" in str(error):  # the last line says what went wrong
            print(f"{type(error).__name__}: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    if not isinstance(outputs, Mapping):
        print(
            f"{place} returned {outputs!r:.60}, not a mapping of outputs by name", file=sys.stderr
        )
        return 1
    numbers = {}
    for output, value in outputs.items():
        try:
            numbers[str(output)] = math.nan if value is None else float(value)
        except (TypeError, ValueError):
            print(f"{place} returned {value!r:.40} for '{output}', not a number", file=sys.stderr)
            return 1
    print()  # whatever the function printed, the outputs are a line of their own
    print(json.dumps({name: v if math.isfinite(v) else None for name, v in numbers.items()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
