"""Counterpart of figure 1 of Yacef et al.: chain of losses of a flight, and map of f_r.

The chain of losses follows the energy from the battery, through the battery's resistance and the
windings of the motors, to the rotors. The map shows f_r, the efficiency of motor and rotor in the
paper of Yacef et al., over rotor speed and torque.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from pyomo_quad.flight.columns import ROTORS, TIME
from pyomo_quad.paper.experiments import PaperFlight
from pyomo_quad.paper.rotor_map import EfficiencyMap
from pyomo_quad.report.signals import MOTOR, POWER, ROTOR_SPEED, TORQUE
from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, PALE, ROTOR_STYLES
from pyomo_quad.scenario import ScenarioError

_MAP_COLORS = "YlGnBu"
_LEVELS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
_BAR = 0.62  # height of a bar relative to the distance between bars
# Margin left and right of the bars, relative to the sum of all losses. The axis does not begin at
# 0, where the losses would be too small to see.
_CHAIN_MARGIN = 0.45
_MILLI = 1e3
# Margin around the flight in the right map, as a share of the range of its values.
_ZOOM_MARGIN = 0.15


@dataclass(frozen=True, kw_only=True)
class EnergyChain:
    """Energies of a flight along its chain of losses, from the battery to the rotors [J].

    Attributes
    ----------
    drawn : float
        Energy drawn from the cells.
    battery_loss, electrical : float
        Loss in the battery's resistance, and energy supplied to the motors.
    copper_loss, shaft : float
        Loss in the motors' windings, and energy supplied to the rotors.
    constant_product : float
        Torque constant k_t times speed constant k_v of a motor: 1 if the motor conserves energy,
        greater if it would create energy.
    """

    drawn: float
    battery_loss: float
    electrical: float
    copper_loss: float
    shaft: float
    constant_product: float

    @property
    def created(self) -> float:
        """Shaft energy minus the electrical energy that remains after the loss in the windings [J].

        For a real motor, k_t k_v = 1 and the difference is zero. With the greater product of the
        constants that Yacef et al. print, the difference is positive.
        """
        return self.shaft - self.passed

    @property
    def passed(self) -> float:
        """Electrical energy of the motors less the loss in their windings [J]."""
        return self.electrical - self.copper_loss


def energy_chain(flown: PaperFlight) -> EnergyChain:
    """Integrate the energy losses of a flight over time, from the battery to the rotors [J].

    `flown` is the optimal flight under the power model `motor`. Without motor constants of the
    vehicle, a ScenarioError is raised.
    """
    frame, scenario = flown.flight.frame, flown.case.scenario
    time = frame[TIME].to_numpy()
    pack = scenario.battery
    resistance = pack.cell_resistance * pack.cells_series / pack.cells_parallel
    current = frame["battery_current_A"].to_numpy()
    motor_current = np.stack([signal.of(frame) for signal in MOTOR[2]])
    shaft_power = sum(
        torque.of(frame) / _MILLI * speed.of(frame)
        for torque, speed in zip(TORQUE, ROTOR_SPEED, strict=True)
    )
    motor = scenario.vehicle.motor
    if motor is None:
        raise ScenarioError("vehicle: the chain of losses needs the electrics of its motors.")
    copper = motor.resistance * (motor_current**2).sum(axis=0)
    battery_loss, electrical, copper_loss, shaft = (
        float(np.trapezoid(power, time))
        for power in (resistance * current**2, POWER.of(frame), copper, shaft_power)
    )
    return EnergyChain(
        drawn=electrical + battery_loss,
        battery_loss=battery_loss,
        electrical=electrical,
        copper_loss=copper_loss,
        shaft=shaft,
        constant_product=motor.product,
    )


def draw_loss_chain(
    chain: EnergyChain, sampled: EfficiencyMap, flown: PaperFlight, bound: float
) -> Figure:
    """Draw the chain of losses of a flight, and below it the flight on the map of f_r.

    f_r falls to zero if a motor brakes its rotor hard enough. `bound` [rad/s²] is the smallest
    deceleration at which f_r is zero at any rotor speed. A line on the map shows the motor torque
    at this deceleration, over the rotor speed.
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
    """Draw the energies of a flight as bars, with the losses between the bars."""
    lowest = min(chain.passed, chain.shaft)
    margin = _CHAIN_MARGIN * (chain.drawn - lowest)
    left = lowest - margin
    remainder = f"Remainder: $k_t k_v$ = {chain.constant_product:.4f}, not 1"
    to_motors = r"To the motors, $V_\mathrm{bat}\, i_\mathrm{bat}$"
    rows: tuple[tuple[str, float, float, str], ...] = (
        ("Drawn from the cells", left, chain.drawn, PALE),
        ("Lost in the pack's resistance", chain.drawn, chain.electrical, MUTED),
        (to_motors, left, chain.electrical, PALE),
        ("Lost in the windings", chain.electrical, chain.passed, MUTED),
        (remainder, chain.passed, chain.shaft, INK),
        (r"To the rotors, $\tau\,\omega$", left, chain.shaft, PALE),
    )
    for row, (_, start, end, color) in enumerate(rows):
        low, high = min(start, end), max(start, end)
        axes.barh(row, high - low, left=low, height=_BAR, color=color, edgecolor=MUTED, lw=0.6)
        text = f"{end:.2f} J" if start == left else f"{end - start:+.2f} J"
        axes.annotate(text, (high, row), (4, 0), textcoords="offset points", va="center", color=INK)
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlim(left, chain.drawn + margin)
    axes.set_title(f"Energy (J); the axis begins at {left:.0f} J")


def _draw_map(axes: Axes, sampled: EfficiencyMap) -> ContourSet:
    grid = sampled.speed, sampled.torque * _MILLI, sampled.efficiency.T
    levels = np.linspace(0.0, 0.35, 15)
    filled = axes.contourf(*grid, levels=levels, cmap=_MAP_COLORS, extend="max")
    axes.contourf(*grid, levels=[-1.0, 0.0], colors="none", hatches=["////"])
    widths = [1.6] + [0.5] * (len(_LEVELS) - 1)
    lines = axes.contour(*grid, levels=_LEVELS, colors=INK, linewidths=widths)
    axes.clabel(lines, fontsize=6.5, fmt="%.2g")
    steady, label = sampled.steady_torque * _MILLI, r"steady, $\kappa\omega^2$"
    axes.plot(sampled.speed, steady, color=MUTED, linewidth=0.9, label=label)
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
