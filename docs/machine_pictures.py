"""Pictures of docs/machine.md: the beamline, the beam along it, the effect of each variable, and the trade-off."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from cartoons import BLUE, GREEN, GREY, ORANGE, PURPLE, RED
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import RegularGridInterpolator

from awa_sim_node.simulation.bunch import Bunch
from awa_sim_node.simulation.constants import CHARGE_OVER_MASS, SPEED_OF_LIGHT
from awa_sim_node.simulation.field_map import FieldMap
from awa_sim_node.simulation.injector import SCREEN, Injector, Resolution, Settings
from awa_sim_node.simulation.moments import emittance, moments
from awa_sim_node.surrogate import Surrogate, metadata
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.pareto import is_nondominated

MIDDLE = {s.name: 0.5 * sum(s.machine_limits) for s in metadata.SETTINGS}
FOCUSED = MIDDLE | {"K2": 262.0, "G1": 62.5}
"""A strong lens on a slow beam: a small emittance, and a waist before the screen."""

POINTS = (
    (MIDDLE, BLUE, "middle of all ranges"),
    (FOCUSED, RED, "$K_2$ = 262 A, $G_1$ = 62.5 MV/m"),
)
SYMBOLS = {
    "K1": "$K_1$",
    "K2": "$K_2$",
    "phi1": r"$\varphi_1$",
    "phi2": r"$\varphi_2$",
    "G1": "$G_1$",
    "G2": "$G_2$",
    "sigma_x": r"$\sigma_x$",
    "sigma_y": r"$\sigma_y$",
    "sigma_z": r"$\sigma_z$",
    "eps_x": r"$\varepsilon_x$",
    "eps_y": r"$\varepsilon_y$",
    "eps_z": r"$\varepsilon_z$",
    "dE": "$dE$",
    "energy": "energy",
}
UNITS = {q.name: q.unit for q in (*metadata.INPUTS, *metadata.OUTPUTS)}
SEVEN = ("sigma_x", "sigma_y", "sigma_z", "eps_x", "eps_y", "eps_z", "dE")
LIMIT = 0.52
"""The paper's limit on dE [MeV]."""

_LIMITS = np.array([s.machine_limits for s in metadata.SETTINGS]).T
_OUTPUTS = [quantity.name for quantity in metadata.OUTPUTS]
_AROUND, _ROUNDS = 2000, 30

COPPER, COIL, PIPE = "#E9B896", "#A9BFD6", "#6E6E6E"


# ---------------------------------------------------------------- the beamline


def draw_beamline() -> Figure:
    """Draw the elements, to scale along the beam, and the fields on axis at the middle of all ranges."""
    line = Injector(_settings(MIDDLE)).beamline
    gun, linac = _on_axis(line.gun), _on_axis(line.linac)
    figure = Figure(figsize=(11.6, 6.4))
    sketch, electric, magnetic = figure.subplots(3, 1, sharex=True, height_ratios=[1.3, 1.0, 1.0])

    sketch.set_title("(a) the elements, to scale along the beam only")
    gun_end = _draw_cells(sketch, gun, 25.0)
    linac_end = _draw_cells(sketch, linac, 50.0)
    for name in ("K1", "K2"):
        z, field = _solenoid(name)
        strong = z[field > 0.5 * field.max()]
        _draw_ring(sketch, strong[0], strong[-1], 115.0, 185.0, COIL)
        sketch.text(strong.mean(), 215.0, SYMBOLS[name], ha="center", va="center")
    pipe = np.array([(gun_end, 25.0), (0.575, 25.0), (0.575, 50.0), (SCREEN, 50.0)])
    for sign in (-1.0, 1.0):
        sketch.plot(pipe[:, 0], sign * pipe[:, 1], color=PIPE, linewidth=1.2)
    for place, radius, color in ((0.0, 25.0, RED), (SCREEN, 50.0, GREEN)):
        sketch.plot(
            [place, place], [-radius, radius], color=color, linewidth=4.0, solid_capstyle="butt"
        )
    sketch.plot([0.0, SCREEN], [0.0, 0.0], color="black", linewidth=0.6, dashes=(12, 4, 2, 4))
    sketch.text(-0.02, 0.0, "cathode", ha="right", va="center")
    sketch.text(SCREEN, -80.0, "screen", ha="center", va="center")
    sketch.text(0.5 * gun_end, -218.0, r"gun ($G_1$, $\varphi_1$)", ha="center", va="center")
    label = r"linac cavity ($G_2$, $\varphi_2$)"
    sketch.text(linac_end - 0.4, -135.0, label, ha="center", va="center")
    sketch.set(ylim=(-250.0, 245.0), ylabel="radius [mm]", yticks=[-50, -25, 0, 25, 50])
    sketch.set_yticklabels(["50", "", "0", "", "50"])

    electric.set_title("(b) accelerating field on axis")
    for (z, field), color, name, symbol in (
        (gun, BLUE, "gun", "G1"),
        (linac, ORANGE, "linac", "G2"),
    ):
        label = f"{name}, {SYMBOLS[symbol]} = {MIDDLE[symbol]:g} MV/m"
        electric.plot(z, 1e-6 * field, color=color, label=label)
    electric.set_ylabel("$E_z$ [MV/m]")
    magnetic.set_title("(c) focusing field on axis")
    for name, color in (("K1", PURPLE), ("K2", GREEN)):
        magnetic.plot(*_solenoid(name), color=color, label=f"{SYMBOLS[name]} = {MIDDLE[name]:g} A")
    magnetic.set(xlabel="z from the cathode [m]", ylabel="$B_z$ [T]", xlim=(-0.25, 3.2))
    for axes in (electric, magnetic):
        axes.axhline(0.0, color="black", linewidth=0.6)
        axes.legend(loc="upper right")
    return figure


def _draw_cells(axes: Axes, curve: tuple[FloatArray, FloatArray], aperture: float) -> float:
    """Draw a cavity, and return the position of its end.

    A cell ends at a sign change of the field on axis, or at the end of the field.
    """
    z, field = curve
    inside = np.flatnonzero(np.abs(field) > 0.15 * np.abs(field).max())
    start, end = inside[0], inside[-1]
    changes = start + np.flatnonzero(np.diff(np.sign(field[start : end + 1])))
    for low, high in pairwise([z[start], *z[changes], z[end]]):
        _draw_ring(axes, low + 0.004, high - 0.004, aperture + 4.0, 105.0, COPPER)
    return float(z[end])


def _solenoid(name: str) -> tuple[FloatArray, FloatArray]:
    """Return positions [m] and the magnitude of one solenoid's field on axis [T], the other one off."""
    alone = _settings(MIDDLE | {"K1": 0.0, "K2": 0.0} | {name: MIDDLE[name]})
    z, field = _on_axis(Injector(alone).beamline.solenoids)
    return z, np.abs(field)


def _draw_ring(axes: Axes, low: float, high: float, inner: float, outer: float, color: str) -> None:
    """Draw the cross-section of a ring around the axis."""
    for bottom in (inner, -outer):
        size = high - low, outer - inner
        axes.add_patch(Rectangle((low, bottom), *size, facecolor=color, edgecolor=GREY))


# ---------------------------------------------------------------- the beam


def draw_beam(particles: int) -> Figure:
    """Draw sizes, emittances and energy of two beams along the machine, with the surrogate's prediction."""
    surrogate = Surrogate.load()
    figure = Figure(figsize=(11.6, 8.4))
    panels = figure.subplots(3, 2, sharex=True)
    shown = (
        (
            ("sigma_x", "sigma_y"),
            "(a) width (solid) and height (dashed), rms",
            "$\\sigma_x$, $\\sigma_y$ [mm]",
        ),
        (
            ("eps_x", "eps_y"),
            "(b) emittance, horizontal (solid) and vertical (dashed)",
            "$\\varepsilon_x$, $\\varepsilon_y$ [mm mrad]",
        ),
        (("sigma_z",), "(c) length, rms", "$\\sigma_z$ [mm]"),
        (("eps_z",), "(d) longitudinal emittance", "$\\varepsilon_z$ [mm mrad]"),
        (("energy",), "(e) mean kinetic energy", "energy [MeV]"),
        (("dE",), "(f) energy spread, rms", "$dE$ [MeV]"),
    )
    for setpoint, color, label in POINTS:
        path = beam_along(setpoint, particles)
        predicted = surrogate.predict(setpoint)
        for axes, (names, _, _) in zip(panels.flat, shown, strict=True):
            for name, dashes in zip(names, ((), (4, 2)), strict=False):
                axes.plot(
                    path["z"],
                    path[name],
                    color=color,
                    dashes=dashes,
                    label=label if not dashes else None,
                )
                axes.plot(
                    SCREEN,
                    predicted[name],
                    "D",
                    color="white",
                    markeredgecolor=color,
                    markersize=6,
                    zorder=4,
                    clip_on=False,
                )
    for axes, (_, title, ylabel) in zip(panels.flat, shown, strict=True):
        axes.set(title=title, ylabel=ylabel, xlim=(0.0, SCREEN))
        for low, high in ((0.0, 0.2927), (0.6714, 1.8785)):
            axes.axvspan(low, high, color="#F2F2F2", linewidth=0.0, zorder=0)
    panels[0, 1].set_ylim(0.0, 130.0)
    for axes in (panels[0, 0], panels[1, 0], panels[1, 1], panels[2, 0], panels[2, 1]):
        axes.set_ylim(bottom=0.0)
    panels[2, 0].text(0.146, 0.7, "gun", ha="center", color="#555555")
    panels[2, 0].text(1.275, 0.7, "linac cavity", ha="center", color="#555555")
    for axes in panels[2]:
        axes.set_xlabel("z from the cathode [m]")
    lines, labels = panels[0, 0].get_legend_handles_labels()
    diamond = panels[0, 0].plot([], [], "D", color="white", markeredgecolor="black", markersize=6)
    figure.legend(
        [*lines, *diamond],
        [*labels, "the surrogate's answer at the screen"],
        loc="outside upper center",
        ncols=3,
    )
    return figure


def beam_along(setpoint: Mapping[str, float], particles: int) -> dict[str, FloatArray]:
    """Return the moments of the simulated beam along the machine, once all particles are emitted.

    The transverse emittances are those of the canonical momenta, so that they do not include the
    rotation inside a solenoid.
    """
    injector = Injector(_settings(setpoint))
    potential = _vector_potential(injector.beamline.solenoids)
    rows: list[dict[str, float]] = []

    def observe(_: float, z: float, bunch: Bunch) -> None:
        beam = moments(bunch)
        if beam.transmission == 1.0 and z > 0.002:
            x, y = _canonical_emittances(bunch, potential)
            rows.append({"z": z, **vars(beam), "eps_x": x, "eps_y": y})

    resolution = Resolution(particles=particles)
    at_screen = injector.track((SCREEN,), resolution, observer=observe)[0]
    rows.append({"z": SCREEN, **vars(at_screen)})
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _canonical_emittances(bunch: Bunch, potential: RegularGridInterpolator) -> tuple[float, float]:
    particles = bunch.flying
    x, y = particles[:, 0], particles[:, 1]
    turn = CHARGE_OVER_MASS / SPEED_OF_LIGHT * potential((np.hypot(x, y), particles[:, 2]))
    return emittance(x, particles[:, 3] - turn * y), emittance(y, particles[:, 4] + turn * x)


def _vector_potential(field: FieldMap) -> RegularGridInterpolator:
    """Return the azimuthal vector potential over the radius [T] as a function of r and z [m]."""
    axial = field.values[:, :, 0]
    r = field.dr * np.arange(len(axial))
    flux = cumulative_trapezoid(axial * r[:, None], r, axis=0, initial=0.0)
    per_radius = np.vstack([0.5 * axial[:1], flux[1:] / r[1:, None] ** 2])
    z = _on_axis(field)[0]
    return RegularGridInterpolator((r, z), per_radius, bounds_error=False, fill_value=0.0)


# ---------------------------------------------------------------- the effect of each variable


def draw_knobs() -> Figure:
    """Draw each of the seven outputs against each of the six variables, around two set-points."""
    surrogate = Surrogate.load()
    figure = Figure(figsize=(12.6, 11.2))
    panels = figure.subplots(len(SEVEN), len(metadata.SETTINGS), sharex="col", sharey="row")
    for column, setting in enumerate(metadata.SETTINGS):
        values = np.linspace(*setting.machine_limits, 101)
        for setpoint, color, label in POINTS:
            predicted = surrogate.predict(setpoint | {setting.name: values})
            here = surrogate.predict(setpoint)
            for axes, name in zip(panels[:, column], SEVEN, strict=True):
                axes.plot(values, predicted[name], color=color, label=label)
                axes.plot(setpoint[setting.name], here[name], "o", color=color, markersize=4)
        panels[-1, column].set_xlabel(f"{SYMBOLS[setting.name]} [{setting.unit}]")
        panels[0, column].set_title(
            setting.meaning.replace("current of the ", ""), fontsize=8.5, loc="center"
        )
    for row, name in zip(panels, SEVEN, strict=True):
        row[0].set_ylabel(f"{SYMBOLS[name]} [{UNITS[name]}]")
        for axes in row:
            axes.grid(color="#E4E4E4", linewidth=0.7)
            axes.margins(x=0.02)
    figure.align_ylabels(panels[:, 0])
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


# ---------------------------------------------------------------- the trade-off


def draw_front(samples: int, evaluations: int, seed: int) -> Figure:
    """Draw emittance against energy spread: random set-points, the best front, and the optimiser's run."""
    sampled = _sampled(samples, seed)
    figure = Figure(figsize=(11.6, 5.0))
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, limited, title in (
        (left, False, "(a) no limit"),
        (right, True, f"(b) constraint $dE$ ≤ {LIMIT:g} MeV"),
    ):
        optimizer = _tuned(limited, evaluations, seed)
        found = optimizer.dataset.column("dE"), optimizer.dataset.column("eps_x")
        axes.set_title(f"{title}: {evaluations} evaluations")
        axes.scatter(*sampled.T, s=1.0, color="#DADADA", linewidths=0.0, rasterized=True)
        best = _best(seed, LIMIT if limited else math.inf)
        axes.plot(*best.T, color=GREEN, linewidth=2.0, label="front that can be reached")
        dots = axes.scatter(
            *found,
            c=np.arange(evaluations),
            cmap="plasma",
            edgecolors="white",
            linewidths=0.6,
            s=32,
            zorder=3,
        )
        points = np.array(
            [[p["objectives"][n] for n in ("dE", "eps_x")] for p in optimizer.pareto_front()]
        )
        axes.plot(
            *points[np.argsort(points[:, 0])].T,
            "o",
            color="none",
            markeredgecolor="black",
            markersize=8,
            zorder=4,
            label="front of the run",
        )
        if limited:
            axes.axvline(LIMIT, color=RED, dashes=(4, 2))
        axes.set_xlabel("energy spread $dE$ [MeV]")
    left.set_ylabel(r"horizontal emittance $\varepsilon_x$ [mm mrad]")
    left.scatter([], [], s=12.0, color="#DADADA", label="random set-points")
    left.legend(loc="upper right")
    figure.colorbar(dots, ax=[left, right], label="evaluation")
    return figure


def _sampled(samples: int, seed: int) -> FloatArray:
    """Return energy spread and emittance of random set-points that keep the beam, ``(n, 2)``."""
    rng = np.random.default_rng(seed)
    low, high = _LIMITS
    values = _objectives(rng.uniform(low, high, (samples, len(low))))
    return values[np.isfinite(values[:, 0])]


def _best(seed: int, limit: float = math.inf) -> FloatArray:
    """Return the best front, ``(n, 2)``, from a random search around the best set-points so far."""
    rng = np.random.default_rng(seed)
    low, high = _LIMITS
    setpoints = rng.uniform(low, high, (_AROUND, len(low)))
    for reach in np.geomspace(0.3, 0.003, _ROUNDS):
        values = _objectives(setpoints)
        values[values[:, 0] > limit] = np.inf
        best = setpoints[is_nondominated(values)]
        steps = rng.normal(0.0, reach, (_AROUND, len(low))) * (high - low)
        around = best[rng.integers(len(best), size=_AROUND)]
        setpoints = np.vstack([best, np.clip(around + steps, low, high)])
    front = _objectives(best)
    return front[np.argsort(front[:, 0])]


def _objectives(setpoints: FloatArray) -> FloatArray:
    """Return energy spread and emittance, ``(n, 2)``; infinite if more than 2 % of the beam is lost."""
    kept = [metadata.DEFAULT_CHARGE, metadata.DEFAULT_COUPLER_KICK]
    inputs = np.hstack([setpoints, np.tile(kept, (len(setpoints), 1))])
    beam = dict(zip(_OUTPUTS, Surrogate.load().predict_array(inputs).T, strict=True))
    values = np.stack([beam["dE"], beam["eps_x"]], axis=1)
    values[beam["transmission"] < 0.98] = np.inf
    return values


def _tuned(limited: bool, evaluations: int, seed: int) -> Optimizer:
    """Return the optimiser after tuning emittance and energy spread without noise."""
    definition: dict[str, Any] = {
        "variables": {
            s.name: dict(zip(("min", "max"), s.machine_limits, strict=True))
            for s in metadata.SETTINGS
        },
        "objectives": {"dE": {"reference": 0.85}, "eps_x": {"reference": 150.0}},
        "constraints": {"transmission": {"min": 0.98}},
    }
    if limited:
        definition["constraints"]["dE"] = {"max": LIMIT}
    optimizer = Optimizer(Problem.from_dict(definition), seed=seed)
    surrogate = Surrogate.load()
    for _ in range(evaluations):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, surrogate.predict(setpoint))
    return optimizer


# ---------------------------------------------------------------- shared by the pictures


def _settings(setpoint: Mapping[str, float]) -> Settings:
    return Settings(
        **setpoint, charge=metadata.DEFAULT_CHARGE, coupler_kick=metadata.DEFAULT_COUPLER_KICK
    )


def _on_axis(field: FieldMap) -> tuple[FloatArray, FloatArray]:
    """Return positions [m] and the field along the beam on axis."""
    values = np.asarray(field.values[0, :, 0], dtype=np.float64)
    positions: FloatArray = field.start + field.dz * np.arange(len(values), dtype=np.float64)
    return positions, values
