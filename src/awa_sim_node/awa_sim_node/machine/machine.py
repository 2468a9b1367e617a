"""The simulated machine: moves, settles and measures in simulated time.

It uses neither a clock nor ROS: its caller advances the simulated time with ``step``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from awa_sim_node.machine.actuators import Actuators
from awa_sim_node.machine.beam import Beam, Shot, ShotStatus
from awa_sim_node.machine.behaviour import Behaviour, Mode
from awa_sim_node.machine.description import ModelDescription
from awa_sim_node.machine.evaluation import Cause, Evaluation, EvaluationFailure, Phase
from awa_sim_node.machine.interlock import Interlock
from awa_sim_node.machine.models import Model, create_model
from awa_sim_node.machine.trips import Trips

MAX_SHOTS: Final = 10_000

# Events closer together than this count as one event [s].
_INSTANT: Final = 1e-9


class SimulatedMachine:
    """A machine with finite speed, noise, drift, trips and an interlock.

    It does one thing at a time: an evaluation (``start_evaluation``), a measurement at the current
    position (``measure``), or a ``move``. Equal seeds and equal calls give equal results, however
    often the readbacks are read; without drift and trips, also for any division of time into steps.
    """

    def __init__(
        self,
        model: str | Model = "awa",
        mode: str = Mode.NOMINAL,
        seed: int | None = None,
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        """Switch the machine on, at its initial set-point and at rest.

        Args:
            model: Name of the model, or the model itself.
            mode: ``ideal``, ``nominal`` or ``rough``: the defaults of all parameters.
            seed: Seed of the random number generators; None takes one from the operating system.
            parameters: Behaviour parameters that differ from the mode's defaults, by name.

        Raises:
            ValueError: If the model, the mode or a parameter is unknown or not allowed, or the seed
                is negative.
        """
        if mode not in list(Mode):
            raise ValueError(f"mode = {mode!r} must be one of {', '.join(Mode)}")
        if seed is not None and seed < 0:
            raise ValueError(f"seed = {seed} must be at least 0")
        self._model = create_model(model) if isinstance(model, str) else model
        self._mode = Mode(mode)
        self._behaviour = self._model.modes[self._mode].changed(parameters or {})
        # Separate random streams, so that reading the readbacks does not change the measurements.
        shots, looks, drift, trips = np.random.SeedSequence(seed).spawn(4)
        self._shot_rng = np.random.default_rng(shots)
        self._look_rng = np.random.default_rng(looks)
        self._actuators = Actuators(self.description, self._model.kinds, self._behaviour)
        self._beam = Beam(
            self._model,
            self._behaviour.beam,
            self._behaviour.jitter,
            self._behaviour.drift,
            np.random.default_rng(drift),
        )
        gun = self._model.gun
        greatest = self.description.variable(gun).maximum if gun else -math.inf
        self._trips = (
            Trips(self._behaviour.trip, greatest, np.random.default_rng(trips)) if gun else None
        )
        self._interlock = Interlock(self._behaviour.interlock)
        self._time = 0.0
        self._evaluation: Evaluation | None = None
        self._time_to_shot = math.inf
        self._on_shot: Callable[[Shot], None] | None = None

    @property
    def description(self) -> ModelDescription:
        """Names, units and limits of this machine."""
        return self._model.description

    @property
    def mode(self) -> Mode:
        """Mode that set the defaults of the behaviour."""
        return self._mode

    @property
    def behaviour(self) -> Behaviour:
        """All parameters of the machine's behaviour."""
        return self._behaviour

    @property
    def time(self) -> float:
        """Simulated time since the machine was switched on [s]."""
        return self._time

    @property
    def setpoint(self) -> dict[str, float]:
        """Set-point of every variable."""
        return self._actuators.targets

    @property
    def settled(self) -> bool:
        """Whether every actuator is settled on its target."""
        return self._actuators.all_settled

    @property
    def settled_variables(self) -> dict[str, bool]:
        """Whether the actuator of each variable is settled on its target."""
        return self._actuators.settled

    @property
    def time_to_ramped(self) -> float:
        """Simulated time until no actuator is ramping [s]; 0 if none is."""
        return self._actuators.time_to_ramped

    @property
    def time_to_settled(self) -> float:
        """Simulated time until every actuator is settled [s]; 0 if all are."""
        return self._actuators.time_to_settled

    @property
    def measuring(self) -> bool:
        """Whether an evaluation or a measurement is running."""
        return self._running is not None

    @property
    def busy(self) -> bool:
        """Whether an actuator is moving or an evaluation is running."""
        return self.measuring or not self.settled

    @property
    def tripped(self) -> bool:
        """Whether there is no beam because the gun has tripped."""
        return self._trips is not None and self._trips.tripped

    @property
    def trips(self) -> int:
        """Number of trips since the machine was switched on."""
        return 0 if self._trips is None else self._trips.count

    @property
    def interlock(self) -> str:
        """Reason why the interlock is raised, in one sentence; empty if it is not."""
        return self._interlock.reason

    @property
    def time_to_next_event(self) -> float:
        """Simulated time until a phase ends, an actuator settles, a shot is due or a trip may occur.

        It is infinite if no event is due [s].
        """
        trips = math.inf if self._trips is None else self._trips.time_to_next_event
        return min(self._time_to_shot, self._actuators.time_to_next_event, trips)

    def readbacks(self) -> dict[str, float]:
        """Return the current readback of every variable."""
        return self._actuators.readbacks(self._look_rng)

    def spread(self) -> dict[str, float]:
        """Return the model's uncertainty of each diagnostic at the inputs of the latest shot.

        It is empty before the first shot, and for a model without uncertainty.
        """
        inputs = self._beam.latest_inputs
        return self._model.spread(inputs) if inputs else {}

    def move(self, setpoint: Mapping[str, float]) -> float:
        """Start moving to ``setpoint``, without a measurement.

        Args:
            setpoint: One value for each variable, in its unit.

        Returns:
            The simulated time until the machine is settled [s].

        Raises:
            ValueError: If a variable is missing, unknown, not finite or outside its limits; nothing
                moves.
            RuntimeError: If the machine is busy; nothing changes.
            InterlockError: If the interlock is raised; nothing changes.
        """
        targets = self._actuators.checked(setpoint)
        self._check_free()
        self._interlock.check()
        self._actuators.set(targets)
        return self.time_to_settled

    def set(self, name: str, value: float) -> None:
        """Start moving one variable; it may be moving already, and the others are unaffected.

        Args:
            name: Name of the variable.
            value: Set-point, in the variable's unit.

        Raises:
            ValueError: If the variable is unknown, or the value not finite or outside its limits.
            RuntimeError: If an evaluation is running.
            InterlockError: If the interlock is raised.
        """
        target = self._actuators.checked({name: value}, partial=True)
        if self.measuring:
            raise RuntimeError("an evaluation is running; wait for it, or stop it first")
        self._interlock.check()
        self._actuators.set(target)

    def start_evaluation(
        self,
        setpoint: Mapping[str, float],
        shots: int | None = None,
        on_shot: Callable[[Shot], None] | None = None,
    ) -> Evaluation:
        """Start an evaluation: move to ``setpoint``, settle, and average some shots.

        Args:
            setpoint: One value for each variable, in its unit.
            shots: Number of shots to average; None for the machine's default.
            on_shot: Callable that receives every shot, including retaken ones; it may ``stop`` the
                machine.

        Returns:
            The evaluation; ``step`` advances it, and its ``result`` is set when it is finished.

        Raises:
            ValueError: If the set-point is not allowed (see ``move``), or ``shots`` is not from 1
                to ``MAX_SHOTS``; nothing moves.
            RuntimeError: If the machine is busy; nothing changes.
            InterlockError: If the interlock is raised; nothing changes.
        """
        count = self._checked_shots(shots)
        return self._start(count, self.move(setpoint), on_shot)

    def measure(
        self, shots: int | None = None, on_shot: Callable[[Shot], None] | None = None
    ) -> Evaluation:
        """Start a measurement at the current position; see ``start_evaluation``."""
        count = self._checked_shots(shots)
        self._check_free()
        self._interlock.check()
        return self._start(count, 0.0, on_shot)

    def free_shot(self) -> Shot | None:
        """Take a shot between evaluations.

        Returns:
            The shot; None during a measurement, without beam, or if the interlock is raised.
        """
        if self.measuring or self.tripped or self._interlock.raised:
            return None
        shot = self._beam.shot(self._time, self._actuators.strengths, self._look_rng)
        self._watch_losses(shot)
        return shot

    def clear_interlock(self) -> None:
        """Clear the interlock, so that the machine may move again."""
        self._interlock.clear()

    def step(self, dt: float) -> None:
        """Advance the simulated time by ``dt`` seconds.

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
        """Stop at once: actuators hold their positions, a running evaluation ends as ``stopped``."""
        self._actuators.hold()
        evaluation = self._running
        if evaluation is not None:
            self._finish(evaluation, Phase.STOPPED)

    @property
    def _running(self) -> Evaluation | None:
        """The running evaluation, or None."""
        evaluation = self._evaluation
        return None if evaluation is None or evaluation.phase.finished else evaluation

    def _check_free(self) -> None:
        if self.busy:
            raise RuntimeError("the machine is busy; wait for it, or stop it first")

    def _checked_shots(self, shots: int | None) -> int:
        count = self._behaviour.beam.shots if shots is None else shots
        if not 1 <= count <= MAX_SHOTS:
            raise ValueError(f"shots = {count} must be from 1 to {MAX_SHOTS}")
        return count

    def _start(
        self, shots: int, settling: float, on_shot: Callable[[Shot], None] | None
    ) -> Evaluation:
        duration = settling + shots * self._period
        self._evaluation = Evaluation(self.setpoint, shots, duration)
        self._on_shot = on_shot
        self._advance_phase(self._evaluation)
        return self._evaluation

    @property
    def _period(self) -> float:
        """Time between two shots [s]."""
        return 1.0 / self._behaviour.beam.repetition_rate

    def _pass(self, dt: float) -> None:
        """Advance by ``dt`` seconds with at most one event, at their end."""
        self._time += dt
        self._actuators.step(dt)
        without_beam = self.tripped
        if self._trips is not None:
            self._trips.step(dt, self._actuators[self._model.gun].position)
        self._time_to_shot -= dt
        evaluation = self._running
        if evaluation is not None:
            evaluation.elapsed += dt
            if without_beam and evaluation.phase is Phase.MEASURE:
                evaluation.waited += dt
                evaluation.without_beam += dt
            self._advance_phase(evaluation)

    def _advance_phase(self, evaluation: Evaluation) -> None:
        """Update the phase from the state of the actuators, the gun and the shots."""
        if evaluation.phase is Phase.RAMP and not self._actuators.ramping:
            evaluation.phase = Phase.SETTLE
        if evaluation.phase is Phase.SETTLE and self.settled:
            evaluation.phase = Phase.MEASURE
            self._time_to_shot = self._period
        if evaluation.phase is not Phase.MEASURE:
            return
        if self.tripped:
            self._time_to_shot = self._period  # counts from the return of the beam
            if evaluation.without_beam >= self._behaviour.trip.patience:
                self._fail(evaluation, Cause.TRIP, "the gun tripped; there is no beam")
        elif self._time_to_shot <= _INSTANT:
            self._time_to_shot += self._period
            self._take_shot(evaluation)

    def _take_shot(self, evaluation: Evaluation) -> None:
        """Take one shot of an evaluation, and end the evaluation if it is complete or failed."""
        shot = self._beam.shot(self._time, self._actuators.strengths, self._shot_rng)
        if shot.status is ShotStatus.RETAKEN:
            evaluation.retaken += 1
            evaluation.waited += self._period
        else:
            evaluation.add(shot, self._actuators.readbacks(self._shot_rng))
        if self._on_shot is not None:
            self._on_shot(shot)
        self._watch_losses(shot)
        if evaluation.phase.finished:
            return
        if evaluation.complete:
            failure = evaluation.verdict(self.description)
            self._finish(evaluation, Phase.FAILED if failure else Phase.DONE, failure)
        elif evaluation.retaken > self._behaviour.beam.retakes * evaluation.shots:
            self._fail(
                evaluation,
                Cause.CHARGE,
                f"the charge of {evaluation.retaken} shots differed from its target of "
                f"{self._behaviour.beam.charge:g} nC by more than "
                f"{100.0 * self._behaviour.beam.charge_window:g} %",
            )

    def _watch_losses(self, shot: Shot) -> None:
        """Count losses; if they raise the interlock, stop the machine and the evaluation."""
        if shot.status in (ShotStatus.GOOD, ShotStatus.LOST):
            self._interlock.see(shot.status is ShotStatus.LOST)
        if not self._interlock.raised:
            return
        self._actuators.hold()
        evaluation = self._running
        if evaluation is not None:
            self._fail(evaluation, Cause.INTERLOCK, self._interlock.reason)

    def _fail(self, evaluation: Evaluation, cause: Cause, message: str) -> None:
        self._finish(evaluation, Phase.FAILED, EvaluationFailure(cause, message))

    def _finish(
        self, evaluation: Evaluation, phase: Phase, failure: EvaluationFailure | None = None
    ) -> None:
        """End the evaluation with the shots taken so far."""
        self._time_to_shot = math.inf
        where = {} if evaluation.taken else self._actuators.readbacks(self._shot_rng)
        evaluation.finish(self.description, phase, failure, where)
