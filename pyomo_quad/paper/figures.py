"""Counterparts of figures 1 to 7 of Yacef et al., and a figure of least energies.

The additional figure shows the least energy of the mission if the power is computed with f_r, the
efficiency of motor and rotor in the paper of Yacef et al.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from pyomo_quad.paper.experiments import Experiment
from pyomo_quad.paper.loss_chain import draw_loss_chain, energy_chain
from pyomo_quad.paper.readings import Reading
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
from pyomo_quad.report.style import INK, MUTED, SERIES_STYLES, panel_grid, styled_flights
from pyomo_quad.scenario import FrequencyUnit, PowerModel, WindCoupling
from pyomo_quad.scenario.battery import Battery

_KILO = 1e3
LOWEST_SHOWN = -2.0  # lower end of the energy axis [kJ]: shows that the literal curve falls on
_HEADROOM = 0.6  # space above the energy of hovering [kJ]


def draw_floors(study: PaperStudy) -> Figure:
    """Draw the least energy of any flight against the bound on the rotor acceleration.

    The bound is on the absolute rotor acceleration. There is one curve for each interpretation of
    the efficiency f_r in `Reading`.

    Parameters
    ----------
    study : PaperStudy
        Results of the study.
    """
    hovering = find_flight(study.flights, Experiment.CALM, PowerModel.EFFICIENCY).hover_energy_J
    figure, panels = panel_grid(1, 1, panel_height=2.9, left=0.6, legend_entries=12)
    axes = panels[0, 0]
    for reading, style in zip(Reading, SERIES_STYLES, strict=False):
        pairs = study.floors[reading]
        bounds, energies = pairs[np.isfinite(pairs[:, 1])].T
        label = f"least energy of any flight, {reading.value} $f_r$"
        look = {"marker": style.marker, "markersize": 3.5, **style.line}
        axes.semilogx(bounds, energies / _KILO, label=label, **look)
    axes.axhline(hovering / _KILO, color=MUTED, linewidth=1.2, label="hovering")
    dashed = {"color": INK, "linewidth": 1.2, "linestyle": (0, (6, 2))}
    axes.axhline(OPTIMAL_ENERGY[1] / _KILO, label="the paper's optimum", **dashed)
    axes.axvspan(
        study.critical_acceleration,
        axes.get_xlim()[1],
        facecolor="none",
        edgecolor=MUTED,
        hatch="..",
        linewidth=0.0,
        label="no minimum with literal $f_r$",
    )
    bounds = study.floors[Reading.LITERAL][:, 0]
    axes.set_xlim(bounds[0], bounds[-1])
    axes.set_ylim(LOWEST_SHOWN, hovering / _KILO + _HEADROOM)
    axes.set_xlabel(r"Bound on the rotor acceleration $|\alpha|$ (rad/s²)")
    axes.set_ylabel("Energy in 10 s (kJ)")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=2)
    return figure


_MOTION_FIGURES = {Experiment.CALM: (3, 4), Experiment.WIND: (5, 6)}


def paper_drawings(study: PaperStudy) -> tuple[Drawing, ...]:
    """Return the report's figures that are counterparts of figures 1 to 7 of Yacef et al.

    `study` has the results that the figures show. A `Drawing` has name, title and caption of a
    figure, and the function that draws the figure.
    """
    return (
        *_power(study),
        *_motion(study, Experiment.CALM),
        *_motion(study, Experiment.WIND),
        *_wind(study),
    )


def floor_drawing(study: PaperStudy) -> Drawing:
    """Return the figure of the least energy of any flight against the bound on rotor acceleration.

    The bound is on the absolute rotor acceleration. The energy is computed with the efficiency f_r
    of Yacef et al., from `study`.
    """
    return Drawing(
        name="floors",
        title="Least energy under f_r",
        caption="Least energy of any flight of the mission under f_r against the bound on the "
        "rotor acceleration. The literal curve falls without end toward the dotted region; below "
        f"{LOWEST_SHOWN:g} kJ it is not shown.",
        draw=partial(draw_floors, study),
    )


def _power(study: PaperStudy) -> Iterator[Drawing]:
    optimum = find_flight(study.flights, Experiment.CALM, PowerModel.MOTOR)
    chain = energy_chain(optimum)
    yield Drawing(
        name="figure_1",
        title="Power-loss chain and efficiency map",
        caption="Figure 1. Above: energy balance of the optimal flight of experiment 1 under the "
        "motors' electrical power; as the rotors end at their initial speed, the last bar is the "
        f"work done on the air. The remainder of {chain.created:+.2f} J is no energy but an "
        "inconsistency of the paper's numbers: k_t and 1/k_v of one motor are equal, but the "
        "printed values are rounded differently. Below: f_r over speed and torque, with the same "
        "flight on it; torques beyond the axis are not shown. Hatched: f_r below zero; dotted "
        "line: the weakest braking torque at which f_r is zero.",
        draw=partial(
            draw_loss_chain, chain, study.efficiency_map, optimum, study.critical_acceleration
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
