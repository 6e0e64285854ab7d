"""The counterpart of the paper's figure 1: where the energy goes, and the efficiency map f_r."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from pyomo_quad.flight.columns import ROTORS, TIME
from pyomo_quad.report.signals import MOTOR, POWER, ROTOR_SPEED, TORQUE
from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, PALE, ROTOR_STYLES
from pyomo_quad.study.paper.efficiency_map import EfficiencyMap
from pyomo_quad.study.paper.flights import PaperFlight

__all__ = ["EnergyChain", "draw_loss_chain", "energy_chain"]

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
    """Integrate the links of the chain over a flight under the motors' electrical power.

    Parameters
    ----------
    flown : PaperFlight
        The flight.

    Returns
    -------
    EnergyChain
        By the trapezoidal rule over the flight's table.
    """
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
    chain : EnergyChain
        Energies to write on the chain.
    sampled : EfficiencyMap
        f_r over torque and speed.
    flown : PaperFlight
        The flight whose rotors are drawn on the map.
    bound : float
        Acceleration at which f_r first passes zero, rad/s².

    Returns
    -------
    Figure
        The chain, the whole map, and the map where the flight is.
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
