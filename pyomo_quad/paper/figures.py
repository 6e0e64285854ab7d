"""The counterparts of the paper's figures 1 to 7, and the figure of the floors."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from pyomo_quad.flight.flight import ROTORS, TIME
from pyomo_quad.paper.experiments import Experiment, PaperFlight
from pyomo_quad.paper.readings import Reading
from pyomo_quad.paper.rotor_map import EfficiencyMap
from pyomo_quad.paper.study import PaperStudy
from pyomo_quad.paper.tables import OPTIMAL_ENERGY, find_flight
from pyomo_quad.report.document import Drawing
from pyomo_quad.report.flight_figures import (
    draw_battery,
    draw_controls,
    draw_rotors,
    draw_states,
    draw_wind,
)
from pyomo_quad.report.gallery import left_out
from pyomo_quad.report.paths import distinct_paths, draw_path
from pyomo_quad.report.style import (
    FULL_WIDTH,
    INK,
    MOTOR,
    MUTED,
    PALE,
    POWER,
    ROTOR_SPEED,
    ROTOR_STYLES,
    SERIES_STYLES,
    TORQUE,
    panel_grid,
    styled_flights,
)
from pyomo_quad.scenario import FrequencyUnit, PowerModel, WindCoupling
from pyomo_quad.scenario.tables import Battery

_KILO = 1e3
LOWEST_SHOWN = -2.0  # kJ: far enough down to see that the literal curve falls without end
_HEADROOM = 0.6  # kJ


def draw_floors(
    floors: dict[Reading, NDArray[np.float64]],
    hover_energy: float,
    printed_energy: float,
    critical: float,
) -> Figure:
    """Draw the least energy of any flight for both readings of f_r.

    Parameters
    ----------
    floors : dict
        Reading -> bounds [rad/s²] and energies [J].
    hover_energy : float
        Of hovering for as long as the mission lasts, J.
    printed_energy : float
        The paper's optimum, J.
    critical : float
        Bound from which f_r passes zero, rad/s².
    """
    figure, panels = panel_grid(1, 1, panel_height=2.9, left=0.6, legend_entries=12)
    axes = panels[0, 0]
    styles = dict(zip(Reading, SERIES_STYLES, strict=False))
    for reading, pairs in floors.items():
        bounds, energies = pairs[np.isfinite(pairs[:, 1])].T
        style = styles[reading]
        label = f"least energy of any flight, {reading.value} $f_r$"
        axes.semilogx(
            bounds, energies / _KILO, label=label, marker=style.marker, markersize=3.5, **style.line
        )
    axes.axhline(hover_energy / _KILO, color=MUTED, linewidth=1.2, label="hovering")
    axes.axhline(
        printed_energy / _KILO,
        color=INK,
        linewidth=1.2,
        linestyle=(0, (6, 2)),
        label="the paper's optimum",
    )
    axes.axvspan(
        critical,
        axes.get_xlim()[1],
        facecolor="none",
        edgecolor=MUTED,
        hatch="..",
        linewidth=0.0,
        label="no minimum with literal $f_r$",
    )
    axes.set_xlim(floors[Reading.LITERAL][0, 0], floors[Reading.LITERAL][-1, 0])
    axes.set_ylim(LOWEST_SHOWN, hover_energy / _KILO + _HEADROOM)
    axes.set_xlabel(r"Bound on the rotor acceleration $|\alpha|$ (rad/s²)")
    axes.set_ylabel("Energy in 10 s (kJ)")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=2)
    return figure


_MAP_COLORS = "YlGnBu"
_LEVELS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
_BAR = 0.62
# The chain's axis begins where its losses can be seen, this share of them below the last stage.
_CHAIN_MARGIN = 0.45
_MILLI = 1e3
_ZOOM_MARGIN = 0.15


@dataclass(frozen=True, kw_only=True)
class EnergyChain:
    """Energies of a flight from the battery to the air, J.

    ``constant_product`` is k_t k_v, one for a motor that conserves energy.
    """

    drawn: float
    battery_loss: float
    electrical: float
    copper_loss: float
    shaft: float
    constant_product: float

    @property
    def created(self) -> float:
        """What the shaft gets beyond what the windings pass on, J.

        The power tau omega exceeds the electromotive force times the current as k_t exceeds 1/k_v.
        """
        return self.shaft - (self.electrical - self.copper_loss)


def energy_chain(flown: PaperFlight) -> EnergyChain:
    """Integrate the links of the chain over a flight under the motors' electrical power."""
    frame, scenario = flown.flight.frame, flown.case.scenario
    time = frame[TIME].to_numpy()
    pack = scenario.battery
    resistance = pack.cell_resistance * pack.cells_series / pack.cells_parallel
    current = frame["battery_current_A"].to_numpy()
    motor_current = np.stack([signal.of(frame) for signal in MOTOR[2]])
    shaft = sum(
        torque.of(frame) / _MILLI * speed.of(frame)
        for torque, speed in zip(TORQUE, ROTOR_SPEED, strict=True)
    )
    battery_loss = float(np.trapezoid(resistance * current**2, time))
    electrical = float(np.trapezoid(POWER.of(frame), time))
    copper = scenario.vehicle.motor_resistance * (motor_current**2).sum(axis=0)
    return EnergyChain(
        drawn=electrical + battery_loss,
        battery_loss=battery_loss,
        electrical=electrical,
        copper_loss=float(np.trapezoid(copper, time)),
        shaft=float(np.trapezoid(shaft, time)),
        constant_product=scenario.vehicle.torque_constant * scenario.vehicle.voltage_constant,
    )


def draw_loss_chain(
    chain: EnergyChain, sampled: EfficiencyMap, flown: PaperFlight, bound: float
) -> Figure:
    """Draw the chain of losses above the efficiency map with the optimal flight on it.

    Parameters
    ----------
    bound : float
        Acceleration at which f_r first passes zero, rad/s².
    """
    figure = Figure(figsize=(FULL_WIDTH, 5.4))
    _draw_chain(figure.add_axes((0.36, 0.735, 0.6, 0.225)), chain)
    whole = figure.add_axes((0.08, 0.12, 0.42, 0.5))
    near = figure.add_axes((0.6, 0.12, 0.29, 0.5))
    box = _flight_box(flown)
    for axes in (whole, near):
        filled = _draw_map(axes, sampled)
        _draw_flight(axes, flown)
    colors = figure.colorbar(filled, cax=figure.add_axes((0.91, 0.12, 0.018, 0.5)))
    colors.set_label("Efficiency function $f_r$ (1)")
    inertia = flown.case.scenario.vehicle.rotor_inertia
    braking = (sampled.steady_torque - inertia * bound) * _MILLI
    whole.plot(sampled.speed, braking, color=INK, linewidth=1.0, linestyle=(0, (1, 1.5)))
    whole.set_ylim(sampled.torque[0] * _MILLI, sampled.torque[-1] * _MILLI)
    whole.add_patch(
        Rectangle((box[0], box[2]), box[1] - box[0], box[3] - box[2], fill=False, edgecolor=INK)
    )
    whole.set_title("Over all speeds allowed; the box is shown on the right")
    near.set(xlim=box[:2], ylim=box[2:])
    near.set_title("Around the optimal flight")
    for axes in (whole, near):
        axes.set_xlabel(r"Rotor speed $\omega$ (rad/s)")
        axes.set_ylabel(r"Motor torque $\tau$ (mN m)")
        axes.grid(visible=False)
    handles, labels = near.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=5)
    return figure


def _draw_chain(axes: Axes, chain: EnergyChain) -> None:
    """Draw stages as bars from the left edge, and between them what is lost or does not add up."""
    lowest = min(chain.electrical - chain.copper_loss, chain.shaft)
    left = lowest - _CHAIN_MARGIN * (chain.drawn - lowest)
    passed = chain.electrical - chain.copper_loss
    rows = (
        ("Drawn from the cells", left, chain.drawn, PALE, f"{chain.drawn:.2f} J"),
        (
            "Lost in the pack's resistance",
            chain.electrical,
            chain.drawn,
            MUTED,
            f"{-chain.battery_loss:+.2f} J",
        ),
        (
            r"To the motors, $V_\mathrm{bat}\, i_\mathrm{bat}$",
            left,
            chain.electrical,
            PALE,
            f"{chain.electrical:.2f} J",
        ),
        ("Lost in the windings", passed, chain.electrical, MUTED, f"{-chain.copper_loss:+.2f} J"),
        (
            f"Remainder: $k_t k_v$ = {chain.constant_product:.4f}, not 1",
            passed,
            chain.shaft,
            INK,
            f"{chain.created:+.2f} J",
        ),
        (r"To the rotors, $\tau\,\omega$", left, chain.shaft, PALE, f"{chain.shaft:.2f} J"),
    )
    for row, (_, start, end, color, text) in enumerate(rows):
        axes.barh(row, end - start, left=start, height=_BAR, color=color, edgecolor=MUTED, lw=0.6)
        axes.annotate(
            text, (max(start, end), row), (4, 0), textcoords="offset points", va="center", color=INK
        )
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlim(left, chain.drawn + _CHAIN_MARGIN * (chain.drawn - lowest))
    axes.set_title(f"Energy (J); the axis begins at {left:.0f} J")


def _draw_map(axes: Axes, sampled: EfficiencyMap) -> ContourSet:
    torque = sampled.torque * _MILLI
    shown = sampled.efficiency.T
    filled = axes.contourf(
        sampled.speed,
        torque,
        shown,
        levels=np.linspace(0.0, 0.35, 15),
        cmap=_MAP_COLORS,
        extend="max",
    )
    axes.contourf(sampled.speed, torque, shown, levels=[-1.0, 0.0], colors="none", hatches=["////"])
    lines = axes.contour(
        sampled.speed,
        torque,
        shown,
        levels=_LEVELS,
        colors=INK,
        linewidths=[1.6] + [0.5] * (len(_LEVELS) - 1),
    )
    axes.clabel(lines, fontsize=6.5, fmt="%.2g")
    axes.plot(
        sampled.speed,
        sampled.steady_torque * _MILLI,
        color=MUTED,
        linewidth=0.9,
        label=r"steady, $\kappa\omega^2$",
    )
    return filled


def _draw_flight(axes: Axes, flown: PaperFlight) -> None:
    frame = flown.flight.frame
    signals = zip(ROTORS, ROTOR_SPEED, TORQUE, ROTOR_STYLES, strict=True)
    for rotor, speed, torque, style in signals:
        axes.plot(speed.of(frame), torque.of(frame), label=f"rotor {rotor}", **style.line)


def _flight_box(flown: PaperFlight) -> tuple[float, float, float, float]:
    frame = flown.flight.frame
    edges: list[float] = []
    for signals in (ROTOR_SPEED, TORQUE):
        values = np.concatenate([signal.of(frame) for signal in signals])
        margin = _ZOOM_MARGIN * np.ptp(values)
        edges += [float(values.min() - margin), float(values.max() + margin)]
    return edges[0], edges[1], edges[2], edges[3]


_MOTION_FIGURES = {Experiment.CALM: (3, 4), Experiment.WIND: (5, 6)}


def paper_drawings(study: PaperStudy) -> tuple[Drawing, ...]:
    """List the counterparts of the paper's figures."""
    return (
        *_power(study),
        *_motion(study, Experiment.CALM),
        *_motion(study, Experiment.WIND),
        *_wind(study),
    )


def floor_drawing(study: PaperStudy) -> Drawing:
    """Return the figure of the least energy under f_r."""
    hovering = find_flight(study.flights, Experiment.CALM, PowerModel.EFFICIENCY).hover_energy_J
    return Drawing(
        name="floors",
        title="Least energy under f_r",
        caption="Least energy of any flight of the mission under f_r against the bound on the "
        "rotor acceleration. The literal curve falls without end toward the dotted region; below "
        f"{LOWEST_SHOWN:g} kJ it is not shown.",
        draw=lambda: draw_floors(
            study.floors, hovering, OPTIMAL_ENERGY[1], study.critical_acceleration
        ),
    )


def _power(study: PaperStudy) -> Iterator[Drawing]:
    optimum = find_flight(study.flights, Experiment.CALM, PowerModel.MOTOR)
    chain = energy_chain(optimum)
    yield Drawing(
        name="figure_1",
        title="Power-loss chain and efficiency map",
        caption="Figure 1. Above: where the energy of the optimal flight of experiment 1 goes, "
        "under the motors' electrical power; as the rotors end as they began, the air takes the "
        f"last bar. The remainder of {chain.created:+.2f} J is no energy but an inconsistency of "
        "the paper's numbers: k_t and 1/k_v of one motor are equal, and the printed digits are "
        "rounded apart. Below: f_r over speed and torque, with the same flight on it; torques "
        "beyond the axis are not shown. Hatched: f_r below zero; dotted line: the braking torque "
        "at which it first gets there.",
        draw=lambda: draw_loss_chain(
            chain, study.efficiency_map, optimum, study.critical_acceleration
        ),
    )
    packs = styled_flights(
        [
            replace(flown.flight, name=_pack_name(flown.case.scenario.battery))
            for flown in study.battery_flights
        ]
    )
    yield Drawing(
        name="figure_2",
        title="Battery voltage and current",
        caption="Figure 2. Voltage, current and charge of both packs on the optimal flight of "
        "experiment 1.",
        draw=lambda: draw_battery(packs),
    )
    motors = styled_flights([optimum.flight])[0]
    yield Drawing(
        name="figure_2_motors",
        title="Motors",
        caption="Figure 2, continued. Speed, torque, current and voltage of the four motors on "
        "the same flight.",
        draw=lambda: draw_rotors(motors),
    )


def _motion(study: PaperStudy, experiment: Experiment) -> Iterator[Drawing]:
    states, path = _MOTION_FIGURES[experiment]
    optimum = find_flight(study.flights, experiment, PowerModel.MOTOR).flight
    flown = [
        baseline.flight
        for baseline in study.baselines
        if baseline.case.experiment is experiment and baseline.case.power_model is PowerModel.MOTOR
    ]
    flights = styled_flights([optimum, *flown])
    alone = flights[:1]
    where = f"experiment {experiment.value}"
    yield Drawing(
        name=f"figure_{states}_states",
        title=f"States, {where}",
        caption=f"Figure {states}. The sixteen states of the optimal flight of {where}.",
        draw=partial(draw_states, alone),
    )
    yield Drawing(
        name=f"figure_{states}_controls",
        title=f"Controls, {where}",
        caption=f"Figure {states}, continued. The four rotor accelerations.",
        draw=partial(draw_controls, alone),
    )
    yield Drawing(
        name=f"figure_{path}",
        title=f"Paths, {where}",
        caption=f"Figure {path}. The optimal path and those under the adaptive controller, "
        f"{where}, with a mark at each fifth of the time.{left_out(flights)}",
        draw=partial(draw_path, distinct_paths(flights)),
    )


def _wind(study: PaperStudy) -> Iterator[Drawing]:
    readings = {
        flown.case.frequency_unit: flown.flight
        for flown in study.wind_flights
        if flown.case.coupling is WindCoupling.ACCELERATION
    }
    for unit, name, text in (
        (FrequencyUnit.RADIAN_PER_SECOND, "figure_7", "Figure 7. The wind, frequencies in rad/s."),
        (FrequencyUnit.HERTZ, "figure_7_hz", "Figure 7, the other reading: frequencies in Hz."),
    ):
        blowing = styled_flights([readings[unit]])[0]
        yield Drawing(name=name, title="Wind", caption=text, draw=partial(draw_wind, blowing))


def _pack_name(battery: Battery) -> str:
    return f"{battery.title}, {battery.cells_series} x {battery.cells_parallel} cells"
