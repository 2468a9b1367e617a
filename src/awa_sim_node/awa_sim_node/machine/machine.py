"""The simulated machine: moves, settles and measures in simulated time.

It knows no clock and no ROS: whoever drives it says how much simulated time has passed, with
``step``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Final

import numpy as np

from awa_sim_node.machine.actuator import Actuator
from awa_sim_node.machine.description import MachineDescription, Variable
from awa_sim_node.machine.diagnostics import NOISELESS, Reading, average
from awa_sim_node.machine.evaluation import Evaluation, EvaluationResult, Phase
from awa_sim_node.machine.models import Model, create_model

MAX_SHOTS: Final = 10_000

# Shots and ends of motion closer together than this are one event [s].
_INSTANT: Final = 1e-9


class Mode(StrEnum):
    """How well the machine behaves: ``ideal`` has no noise, ``nominal`` that of a good day."""

    IDEAL = "ideal"
    NOMINAL = "nominal"


class SimulatedMachine:
    """A machine that takes its time and measures with noise.

    It does one thing at a time: an evaluation (``start_evaluation``) or a mere ``move``. Equal
    seeds and equal orders give equal results, however time is cut into steps and however often the
    readbacks are looked at.
    """

    def __init__(
        self, model: str | Model = "awa", mode: str = Mode.NOMINAL, seed: int | None = None
    ) -> None:
        """Switch the machine on, at its initial set-point and at rest.

        Args:
            model: Name of the model, or the model itself.
            mode: ``ideal`` or ``nominal``.
            seed: Seed of all noise; None takes one from the operating system.

        Raises:
            ValueError: If the model or the mode is not known, or the seed is negative.
        """
        if mode not in list(Mode):
            raise ValueError(f"mode = {mode!r} must be one of {', '.join(Mode)}")
        if seed is not None and seed < 0:
            raise ValueError(f"seed = {seed} must be at least 0")
        self._model = create_model(model) if isinstance(model, str) else model
        self._mode = Mode(mode)
        # Two streams: looking at readbacks must not change what is measured.
        shots, looks = np.random.SeedSequence(seed).spawn(2)
        self._shot_rng = np.random.default_rng(shots)
        self._look_rng = np.random.default_rng(looks)
        self._actuators = {
            variable.name: Actuator(self._model.actuators[variable.name], variable.initial)
            for variable in self.description.variables
        }
        self._time = 0.0
        self._evaluation: Evaluation | None = None
        self._true_values: dict[str, float] = {}
        self._shots: dict[str, list[float]] = {}
        self._on_shot: Callable[[dict[str, float]], None] | None = None
        self._time_to_shot = math.inf

    @property
    def description(self) -> MachineDescription:
        """Names, units and limits of this machine."""
        return self._model.description

    @property
    def mode(self) -> Mode:
        """How well the machine behaves."""
        return self._mode

    @property
    def time(self) -> float:
        """Simulated time since the machine was switched on [s]."""
        return self._time

    @property
    def setpoint(self) -> dict[str, float]:
        """Where every variable was told to be."""
        return {name: actuator.target for name, actuator in self._actuators.items()}

    @property
    def settled(self) -> bool:
        """Whether every actuator rests on its target."""
        return all(actuator.settled for actuator in self._actuators.values())

    @property
    def time_to_ramped(self) -> float:
        """Simulated time until every actuator has stopped ramping [s]; 0 if none does."""
        return max(actuator.time_to_ramped for actuator in self._actuators.values())

    @property
    def time_to_settled(self) -> float:
        """Simulated time until every actuator rests on its target [s]; 0 if all do."""
        return max(actuator.time_to_settled for actuator in self._actuators.values())

    @property
    def busy(self) -> bool:
        """Whether something moves or an evaluation runs."""
        return self._running is not None or not self.settled

    @property
    def time_to_next_event(self) -> float:
        """Simulated time until a phase ends, an actuator settles or a shot is taken [s].

        It is infinite when the machine rests.
        """
        times = [self._time_to_shot]
        for actuator in self._actuators.values():
            if not actuator.settled:
                times.append(
                    actuator.time_to_ramped if actuator.ramping else actuator.time_to_settled
                )
        return min(times)

    def readbacks(self) -> dict[str, float]:
        """Return every variable as its own instrument shows it now."""
        return {name: self._readback(name, self._look_rng) for name in self._actuators}

    def move(self, setpoint: Mapping[str, float]) -> float:
        """Start moving to ``setpoint``, without measuring there.

        Args:
            setpoint: One value for each variable, in its unit.

        Returns:
            The simulated time until all is settled [s].

        Raises:
            ValueError: If a variable is missing, unknown, not finite or outside its limits; nothing
                moves.
            RuntimeError: If the machine is busy; nothing changes.
        """
        targets = self._checked(setpoint)
        if self.busy:
            raise RuntimeError(
                "the machine is busy: stop it, or let it finish, before it moves again"
            )
        for name, target in targets.items():
            self._actuators[name].set(target)
        return self.time_to_settled

    def start_evaluation(
        self,
        setpoint: Mapping[str, float],
        shots: int | None = None,
        on_shot: Callable[[dict[str, float]], None] | None = None,
    ) -> Evaluation:
        """Start an evaluation: go to ``setpoint``, settle, and average some shots.

        Args:
            setpoint: One value for each variable, in its unit.
            shots: Number of shots to average; None for the machine's usual number.
            on_shot: Is given the diagnostics of every shot, and may ``stop`` the machine.

        Returns:
            The evaluation; ``step`` drives it on, and its ``result`` is there once it is finished.

        Raises:
            ValueError: If the set-point is not allowed (see ``move``), or the shots are not from 1
                to ``MAX_SHOTS``; nothing moves.
            RuntimeError: If the machine is busy; nothing changes.
        """
        count = self.description.shots if shots is None else shots
        if not 1 <= count <= MAX_SHOTS:
            raise ValueError(f"shots = {count} must be from 1 to {MAX_SHOTS}")
        settling = self.move(setpoint)
        duration = settling + count / self.description.repetition_rate
        self._evaluation = Evaluation(self.setpoint, count, duration)
        self._shots = {name: [] for name in self._actuators}
        self._on_shot = on_shot
        self._shots |= {diagnostic.name: [] for diagnostic in self.description.diagnostics}
        self._advance_phase(self._evaluation)
        return self._evaluation

    def step(self, dt: float) -> None:
        """Let ``dt`` seconds of simulated time pass.

        Raises:
            ValueError: If ``dt`` is negative or not finite.
        """
        if not (dt >= 0.0 and math.isfinite(dt)):
            raise ValueError(f"dt = {dt} must be finite and at least 0")
        left = dt
        while left > 0.0:
            part = min(left, max(self.time_to_next_event, _INSTANT))
            left -= part
            self._pass(part)

    def stop(self) -> None:
        """Stop at once: actuators hold where they are, a running evaluation ends as ``stopped``."""
        for actuator in self._actuators.values():
            actuator.hold()
        evaluation = self._running
        if evaluation is not None:
            self._finish(evaluation, Phase.STOPPED)

    @property
    def _running(self) -> Evaluation | None:
        """The evaluation that is not finished yet, if there is one."""
        evaluation = self._evaluation
        return None if evaluation is None or evaluation.phase.finished else evaluation

    def _pass(self, dt: float) -> None:
        """Let ``dt`` seconds pass, within which nothing happens but at their end."""
        self._time += dt
        for actuator in self._actuators.values():
            actuator.step(dt)
        self._time_to_shot -= dt
        evaluation = self._running
        if evaluation is not None:
            evaluation.elapsed += dt
            self._advance_phase(evaluation)

    def _advance_phase(self, evaluation: Evaluation) -> None:
        """Bring the phase up to date with the actuators and the shots."""
        if evaluation.phase is Phase.RAMP and not any(a.ramping for a in self._actuators.values()):
            evaluation.phase = Phase.SETTLE
        if evaluation.phase is Phase.SETTLE and self.settled:
            evaluation.phase = Phase.MEASURE
            self._true_values = self._model.true_values(self._positions())
            self._time_to_shot = 1.0 / self.description.repetition_rate
        if evaluation.phase is Phase.MEASURE and self._time_to_shot <= _INSTANT:
            self._time_to_shot += 1.0 / self.description.repetition_rate
            self._take_shot()
            if self._shots_taken == evaluation.shots and not evaluation.phase.finished:
                self._finish(evaluation, Phase.DONE)

    @property
    def _shots_taken(self) -> int:
        return len(self._shots[self.description.variables[0].name])

    def _take_shot(self) -> None:
        """Add one measured value to every variable and diagnostic."""
        for name in self._actuators:
            self._shots[name].append(self._readback(name, self._shot_rng))
        shot = {}
        for diagnostic in self.description.diagnostics:
            noise = NOISELESS if self._mode is Mode.IDEAL else self._model.noise[diagnostic.name]
            value = noise.shot(self._true_values[diagnostic.name], self._shot_rng)
            self._shots[diagnostic.name].append(value)
            shot[diagnostic.name] = value
        if self._on_shot is not None:
            self._on_shot(shot)

    def _finish(self, evaluation: Evaluation, phase: Phase) -> None:
        """End the evaluation with what was measured so far."""
        self._time_to_shot = math.inf
        if self._shots_taken == 0:
            # Where the machine was stopped is worth knowing even if no shot was taken there.
            for name in self._actuators:
                self._shots[name].append(self._readback(name, self._shot_rng))
            taken = 0
        else:
            taken = self._shots_taken
        evaluation.result = EvaluationResult(
            readbacks=tuple(self._reading(v.name, v.unit) for v in self.description.variables),
            diagnostics=tuple(self._reading(d.name, d.unit) for d in self.description.diagnostics),
            shots=taken,
            duration=evaluation.elapsed,
        )
        evaluation.phase = phase

    def _reading(self, name: str, unit: str) -> Reading:
        value, stddev = average(self._shots[name])
        return Reading(name, value, stddev, unit)

    def _readback(self, name: str, rng: np.random.Generator) -> float:
        actuator = self._actuators[name]
        return actuator.position if self._mode is Mode.IDEAL else actuator.readback(rng)

    def _positions(self) -> dict[str, float]:
        return {name: actuator.position for name, actuator in self._actuators.items()}

    def _checked(self, setpoint: Mapping[str, float]) -> dict[str, float]:
        """Return the set-point in the machine's order; ValueError if it is not allowed."""
        variables = self.description.variables
        names = ", ".join(variable.name for variable in variables)
        unknown = sorted(set(setpoint) - set(self._actuators))
        if unknown:
            raise ValueError(
                f"set-point names {unknown[0]!r}, but the machine's variables are {names}"
            )
        missing = [variable.name for variable in variables if variable.name not in setpoint]
        if missing:
            raise ValueError(
                f"set-point lacks {missing[0]!r}; it must name all of the variables {names}"
            )
        return {variable.name: _within(variable, setpoint[variable.name]) for variable in variables}


def _within(variable: Variable, value: float) -> float:
    """Return ``value`` as a float; ValueError if it is outside the limits of ``variable``."""
    number = float(value)
    if not variable.minimum <= number <= variable.maximum:
        unit = f" {variable.unit}" if variable.unit else ""
        raise ValueError(
            f"set-point {variable.name} = {number:g}{unit} is outside the machine's limits, "
            f"{variable.minimum:g} to {variable.maximum:g}{unit}"
        )
    return number
