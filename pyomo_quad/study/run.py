"""Run of a scenario: plan, simulated flights, their comparison, and lower bound on the energy.

The simulated flights follow the plan or other reference trajectories, such as a smooth path.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import pandas as pd

from pyomo_quad.collocation import Dynamics, EngineError, Progress, Summarised
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name, fly_baseline, fly_open_loop
from pyomo_quad.flight.columns import TIME, WIND, dataset_of
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.flight.replanning import fly_replanned, replanned_name
from pyomo_quad.flight.risk import plan_at_risk
from pyomo_quad.flight.weather import vehicle_flown
from pyomo_quad.presentation import presenter
from pyomo_quad.processes import side_by_side
from pyomo_quad.scenario import Reference, Scenario, ScenarioError
from pyomo_quad.study.aims import disagreement, energy_and_charge
from pyomo_quad.study.autopilot import TUNED_CRUISE, Tuning, fly_cruise, tune_cruise
from pyomo_quad.study.certificate import Certificate, certify
from pyomo_quad.study.check import plan_cautions
from pyomo_quad.study.comparison import (
    OPTIMAL,
    adaptation_study,
    combine,
    compare_flights,
)
from pyomo_quad.study.ensemble import InTurbulence, fly_in_turbulence
from pyomo_quad.study.front import energy_time_front

if TYPE_CHECKING:
    import xarray as xr

    from pyomo_quad.presentation import Picture


@dataclass(frozen=True, kw_only=True, repr=False)
class RunResult(Summarised):
    """Results of a run: plan, flights, comparison and lower bound.

    Attributes
    ----------
    scenario : Scenario
        Scenario that was run.
    plan : Plan
        Plan of the scenario. Its `status` tells whether the solve succeeded and whether simulation
        confirmed the plan.
    flights : tuple of Flight
        The flight of the plan first, then the simulated flights; empty if the solve failed.
    comparison : DataFrame
        One row per flight, columns of `ComparisonColumn` in `study.comparison`.
    certificate : Certificate
        Lower bound on the energy of the mission in the actual wind.
    adaptation : DataFrame or None
        Effect of the controller's adaptation to the wind, from `comparison.adaptation_study`; None
        in calm air, or if it could not be simulated.
    front : DataFrame
        Energy-time front: least energy against duration, see `study.front`; empty if the duration
        is fixed or the plan is not verified (`Plan.is_verified`).
    aims : DataFrame
        Plans of least energy and of least battery charge, from `study.aims.energy_and_charge`;
        empty if the plan is not verified, or the function finds no other plan to compare with.
    timings : mapping
        Wall-clock times [s] by name. The times of planning have the names in `Plan.timings`.
        "certify" is the time for the lower bound, "front" that for the tables `front` and `aims`.
        "fly" is the time from the end of planning to the end of the last flight. It excludes
        "certify", "front" and the time of the callback `meanwhile` of `run_scenario`, which come in
        between.
    warnings : tuple of str
        Cautions about the results, one line each.
    tuning : Tuning or None
        The tuned autopilot with all settings tried; None if no autopilot was tuned, or if the
        tuning failed.
    often : InTurbulence or None
        Many flights in turbulence, of the plan and of an autopilot. None without turbulence, if the
        plan must not be flown, or if a simulation fails.
    """

    scenario: Scenario
    plan: Plan
    flights: tuple[Flight, ...]
    comparison: pd.DataFrame
    certificate: Certificate
    adaptation: pd.DataFrame | None
    front: pd.DataFrame
    aims: pd.DataFrame
    timings: Mapping[str, float]
    warnings: tuple[str, ...]
    tuning: Tuning | None = None
    often: InTurbulence | None = None

    @property
    def summary(self) -> dict[str, str]:
        """Summary of the run, as a mapping from the name of a result to its value as text.

        The results include the status of the plan, the energy of each flight and the lower bound.
        """
        bound = self.certificate.lower_bound_J
        return {
            "scenario": self.scenario.name,
            "status": self.plan.status.value,
            **{flight.name: f"{flight.energy_J:.2f} J" for flight in self.flights},
            "no flight below": "unknown" if bound is None else f"{bound:.2f} J",
            **({} if self.often is None else {"held": str(self.often.flown.succeeded)}),
        }

    @property
    def gap_percent(self) -> float | None:
        """Optimality gap in per cent: 100 (energy of the plan - lower bound) / energy of the plan.

        Any other flight can save at most this part. None if the run has no flights, if no bound is
        known, or if the plan was made for a wind forecast.
        """
        if not self.flights or self.scenario.wind.forecast is not None:
            return None
        return self.certificate.gap_percent(self.plan.energy)

    def to_frame(self) -> pd.DataFrame:
        """Return the tables of all flights as one table, indexed by "flight" and "time_s".

        Examples
        --------
        >>> frame = result.to_frame()
        >>> frame.index.names
        FrozenList(['flight', 'time_s'])
        >>> bool(frame.loc["optimal", "energy_J"].is_monotonic_increasing)
        True
        """
        tables = {flight.name: flight.frame.set_index(TIME) for flight in self.flights}
        return pd.concat(tables, names=["flight", TIME]) if tables else pd.DataFrame()

    def to_xarray(self) -> "xr.Dataset":
        """Return all flights as a dataset over "flight" and "sample", with units.

        "time_s" is a variable over both dimensions; shorter flights end in NaN. Energies, duration
        and "terminal_miss_m" (distance from the goal) are variables over "flight". Scenario, status
        and lower bound are attributes.

        Examples
        --------
        >>> data = result.to_xarray()
        >>> float(data.total_energy_J.sel(flight="optimal")) == result.plan.energy
        True
        """
        import xarray as xr  # noqa: PLC0415  a second that a run has no use for

        names = pd.Index([flight.name for flight in self.flights], name="flight")
        tables = [dataset_of(f.frame.rename_axis("sample")) for f in self.flights]
        data = xr.concat(tables, names, join="outer") if tables else xr.Dataset()
        for name, unit, values in (
            ("total_energy_J", "J", [flight.energy_J for flight in self.flights]),
            ("owed_energy_J", "J", [flight.owed_energy_J for flight in self.flights]),
            ("duration_s", "s", [flight.duration_s for flight in self.flights]),
            ("terminal_miss_m", "m", [flight.terminal_miss_m for flight in self.flights]),
        ):
            data[name] = ("flight", values, {"units": unit})
        bound = self.certificate.lower_bound_J
        return data.assign_attrs(
            scenario=self.scenario.name,
            scenario_resolved=self.scenario.model_dump_json(),
            status=self.plan.status.value,
            lower_bound_J=float("nan") if bound is None else bound,
        )

    def save(self, path: str | Path) -> None:
        """Write the dataset of `to_xarray` to a NetCDF file, which `xarray.open_dataset` reads.

        `Plan.save` writes the plan, from which another solve can start.

        Examples
        --------
        >>> import xarray
        >>> result.save("hop.nc")
        >>> xarray.open_dataset("hop.nc").attrs["status"]
        'verified'
        """
        self.to_xarray().to_netcdf(path, engine="h5netcdf")

    def plot(self, what: str = "map") -> "Picture":
        """Draw a figure of the run, or a column of its plan's table over time.

        Parameters
        ----------
        what : str, default "map"
            "map", "power_over_time", "energy_split", "path", "energy", "adaptation", "front", ...,
            or a column of `Plan.to_frame`; the error for an unknown name lists all names.

        Returns
        -------
        Picture
            Figure that a notebook displays and that `Picture.save` writes to a file;
            `Picture.figure` is the matplotlib Figure.

        Raises
        ------
        ScenarioError
            If the run has no figure and no column of this name.

        Examples
        --------
        >>> result.plot("energy_split").name
        'energy_split'
        """
        return presenter().picture_of_run(self, what)

    def report(self, folder: str | Path, *, figures: str = "svg") -> Path:
        """Write the report of the run into a folder, as `pyomo-quad run` does.

        Parameters
        ----------
        folder : str or Path
            Folder that receives the report: a new folder, an empty one, or one that holds an
            earlier report. The new report appears there only when it is complete.
        figures : {"svg", "png", "all", "none"}, optional
            Formats of the figures.

        Returns
        -------
        Path
            The page, `report.html`.

        Raises
        ------
        OutputError
            If the folder cannot be written, or holds files that no report wrote.

        Examples
        --------
        >>> print(result.report("reports/hop_run", figures="none"))
        reports/hop_run/report.html
        """
        return presenter().report_run(self, folder, figures)


def run_scenario(
    scenario: Scenario,
    *,
    planner: Planner | None = None,
    baselines: Sequence[Reference] | None = None,
    progress: Progress | None = None,
    meanwhile: Callable[[], object] = lambda: None,
) -> RunResult:
    """Plan a scenario, simulate and compare all flights, and compute the lower bound.

    A failed solve or flight raises no exception. At the time limit (`solver.time_limit`), all
    solves and simulations stop; a warning then replaces each unfinished flight. On Linux, the
    flights run in parallel if the environment variable `OMP_NUM_THREADS` is 1.

    Parameters
    ----------
    scenario : Scenario
        Mission, vehicle, wind and settings.
    planner : Planner, optional
        Planner whose compiled models the run uses; by default a new planner.
    baselines : sequence of Reference, optional
        Reference trajectories that the controller tracks in the simulated flights, for comparison
        with the plan; by default those that the scenario names.
    progress : callable, optional
        Called at each Ipopt iteration; returning False stops the solve. If the solve is stopped
        without a plan that simulation confirms, the result has no flights.
    meanwhile : callable, optional
        Called once during the flights, for instance to import modules of the report.

    Returns
    -------
    RunResult
        Plan, flights, comparison and lower bound.

    Examples
    --------
    >>> result = run_scenario(scenario, baselines=[Reference.QUINTIC])
    >>> [flight.name for flight in result.flights]
    ['optimal', 'adaptive/quintic', 'open_loop/plan']
    >>> result.gap_percent < 1.0
    True
    """
    references = scenario.baseline.references if baselines is None else tuple(baselines)
    with Deadline(scenario):
        return _run(scenario, planner or Planner(), references, progress, meanwhile)


def _run(
    scenario: Scenario,
    planner: Planner,
    references: Sequence[Reference],
    progress: Progress | None,
    meanwhile: Callable[[], object],
) -> RunResult:
    plan = plan_at_risk(scenario, planner, progress=progress)
    began = perf_counter()
    mission, dynamics = plan.mission_flown, vehicle_flown(planner, plan.mission_flown)
    tried = [*_baselines(mission, plan, planner, references)] if plan.verification else []
    optimum = plan.flight(OPTIMAL) if plan.verification else None
    # The slowest flights are listed last, so tasks begin with them.
    tasks: tuple[Callable[[], object], ...] = (
        *(partial(_flight_or_reason, name, fly) for name, fly in reversed(tried)),
        partial(_adaptation, mission, optimum, dynamics),
        partial(plan_cautions, plan, planner=planner),
    )
    with side_by_side(tasks) as finish:
        here = perf_counter()
        certificate = certify(scenario, planner=planner)
        certified = perf_counter()
        front = energy_time_front(plan, planner=planner, progress=progress)
        aims = energy_and_charge(plan, planner=planner, progress=progress)
        swept = perf_counter()
        meanwhile()
        helping = perf_counter()
        *flown, adaptation, cautions = finish()
    flown.reverse()
    tuning = next((one for one in flown if isinstance(one, Tuning)), None)
    flown = [one.flight if isinstance(one, Tuning) else one for one in flown]
    completed = tuple(flight for flight in flown if isinstance(flight, Flight))
    flights = () if optimum is None else (optimum, *completed)
    flights = _priced(flights, mission, planner, progress)
    often, refused = _often(plan, planner, tuning, references)
    ended = perf_counter()
    comparison = combine([])
    if flights:
        comparison = compare_flights(mission, flights, certificate, plan.hover_energy_J)
    return RunResult(
        scenario=scenario,
        plan=plan,
        flights=flights,
        comparison=comparison,
        certificate=certificate,
        adaptation=adaptation,
        front=front,
        aims=aims,
        timings={
            **plan.timings,
            "fly": (ended - began) - (helping - here),
            "certify": certified - here,
            "front": swept - certified,
        },
        warnings=(*cautions, *disagreement(aims), *_failures(flown, flights), *refused),
        tuning=tuning,
        often=often,
    )


def _failures(flown: Sequence[object], flights: Sequence[Flight]) -> Iterator[str]:
    """Yield a warning for each simulated flight that failed, or whose simulation is doubtful.

    `flown` has a flight or, as text, the reason of failure for each simulation. `flights` has the
    plan's flight and all simulated flights. Their `doubt` says why a flight is doubtful.
    """
    yield from (why for why in flown if isinstance(why, str))
    yield from (f"{f.name}: not confirmed: {f.doubt}." for f in flights if f.doubt)


def _often(
    plan: Plan, planner: Planner, tuning: Tuning | None, references: Sequence[Reference]
) -> tuple[InTurbulence | None, tuple[str, ...]]:
    """Simulate many flights of a run in turbulence; return them, and a warning if this fails.

    They follow the plan, or an autopilot with the settings in `tuning`. Without `tuning`, it flies
    at the first cruise speed if `references` include the cruise. The flights are None after a
    failure, without turbulence, or if the plan must not be flown.
    """
    baseline = plan.scenario.baseline
    cruise = None if tuning is None else tuning.settings
    # Without a tuned autopilot, one with the first cruise speed flies in the same winds.
    if tuning is None and baseline.cruise_speeds and Reference.CRUISE in references:
        cruise = baseline.cruise_settings(baseline.cruise_speeds[0])
    try:
        return fly_in_turbulence(plan, cruise, is_tuned=tuning is not None, planner=planner), ()
    except (EngineError, ScenarioError) as error:
        return None, (f"no flights in turbulence: {error}",)


def _priced(
    flights: tuple[Flight, ...], scenario: Scenario, planner: Planner, progress: Progress | None
) -> tuple[Flight, ...]:
    """Return the flights with their owed energy: the energy from the end to the exact goal state.

    An energy that cannot be estimated is NaN.
    """
    # Without a forecast, the costates of the run's plan have already priced all flights.
    if scenario.wind.forecast is None or not flights:
        return flights
    # The run's plan was made for the forecast wind, but the other flights were simulated in the
    # actual wind, so the costates of a plan for the actual wind apply to them.
    told = planner.solve(scenario.as_it_blows(), progress=progress)
    prices = told.end_prices if told.verification is not None else {}
    optimum, *others = flights
    return (optimum, *(flight.priced(prices) for flight in others))


def _adaptation(
    scenario: Scenario, optimum: Flight | None, dynamics: Dynamics
) -> pd.DataFrame | None:
    """Simulate a run's mission with and without the controller's adaptation to the wind.

    The result is the table of `adaptation_study`. It is None if `optimum`, the plan's flight, is
    None or meets no wind. It is also None if a simulation fails.
    """
    if optimum is None or not set(WIND) <= set(optimum.frame):
        return None
    if not optimum.frame[list(WIND)].to_numpy().any():
        return None
    try:
        return adaptation_study(scenario, dynamics=dynamics)
    except EngineError:
        return None


def _flight_or_reason(name: str, fly: Callable[[], Flight | Tuning]) -> Flight | Tuning | str:
    try:
        return fly()
    except (EngineError, ScenarioError) as error:
        return f"{name} could not be flown: {error}"


def _baselines(
    scenario: Scenario, plan: Plan, planner: Planner, references: Sequence[Reference]
) -> Iterator[tuple[str, Callable[[], Flight | Tuning]]]:
    dynamics, asked = vehicle_flown(planner, scenario), plan.scenario
    if Reference.CRUISE in references and len(set(asked.mission.positions)) > 1:
        yield TUNED_CRUISE, partial(tune_cruise, asked, plan, planner)
        for speed in scenario.baseline.cruise_speeds or ():
            settings = scenario.baseline.cruise_settings(speed)
            yield (
                baseline_name(Reference.CRUISE, speed),
                partial(fly_cruise, asked, settings, plan, planner),
            )
    for reference in references:
        if reference is Reference.CRUISE:
            continue
        yield (
            baseline_name(reference),
            partial(fly_baseline, scenario, reference, dynamics=dynamics, plan=plan),
        )
    for knowledge in () if scenario.baseline.mpc is None else scenario.baseline.mpc.knowledge:
        told = partial(fly_replanned, scenario, knowledge, dynamics=dynamics, planner=planner)
        yield replanned_name(knowledge), partial(told, plan=plan)
    yield OPEN_LOOP, partial(fly_open_loop, scenario, plan, dynamics)
