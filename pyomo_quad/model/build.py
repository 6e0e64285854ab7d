"""Functions that build the continuous-time Pyomo model of a mission.

A scenario may name a model builder: a Python function of the user that builds the model in place of
`build_model`. The function `model_builder` returns the builder that a scenario selects.
"""

from collections.abc import Callable, Hashable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from pyomo.core import Block, ConcreteModel, Objective, Param, Suffix, Var, minimize
from pyomo.core.base.units_container import units
from pyomo.dae import ContinuousSet, Integral

from pyomo_quad.model import (
    aerodynamics,
    airspace,
    battery,
    ground,
    homing,
    limits,
    mission,
    power,
    rotors,
    soft_limits,
    turbulence,
    vehicle,
    wind,
)
from pyomo_quad.model.parameters import parameter_items, parameter_tables
from pyomo_quad.model.rigid_body import declare_balances, declare_motion
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.mission import Aim

Builder = Callable[[Scenario], ConcreteModel]


def build_model(scenario: Scenario) -> ConcreteModel:
    """Declare the mission as a continuous-time Pyomo model.

    Parameters
    ----------
    scenario : Scenario
        The mission. The model has the scenario's actual wind; for a model with the forecast wind,
        pass ``scenario.as_forecast()``.

    Returns
    -------
    ConcreteModel
        Model with the blocks ``vehicle, rigid_body, rotors, wind, aerodynamics, power, battery,
        limits, airspace, mission``. A scenario with terrain adds the block ``ground``, a return
        reserve the block ``homing``. The set ``time`` is not discretised. Its members are the
        start, the end, and a nominal time for each arrival at and departure from a waypoint.
        Without waypoints, half the duration is a member. A free duration is the variable
        ``duration``. The parameter ``clock`` is the time, for equations that depend on time.
        ``energy`` is the energy of the flight [J], the integral of the power over time. The
        ``objective`` is minimised. The suffix ``scaling_factor`` holds one over the usual magnitude
        of each variable.

    Raises
    ------
    ScenarioError
        If start, goal or a waypoint without radius is inside a keep-out zone or on its surface.

    Examples
    --------
    Constraints over ``time`` added to the model take part in its solve:

    >>> model = build_model(scenario)  # doctest: +SKIP
    >>> model.ceiling = Constraint(
    ...     model.time, rule=lambda m, t: m.rigid_body.z[t] <= 8.5 * units.m
    ... )  # doctest: +SKIP
    """
    m = _vehicle_in_the_wind(scenario)
    aerodynamics.declare_aerodynamics(m, scenario)
    _declare_flight(m, scenario)
    return m


def build_in_turbulence(scenario: Scenario) -> ConcreteModel:
    """Build the model of a mission in turbulent wind, for simulated flights.

    Parameters
    ----------
    scenario : Scenario
        Mission with ``wind.turbulence``.

    Returns
    -------
    ConcreteModel
        The model of `build_model` with the Dryden shaping filters of the gusts in block
        `wind.turbulence`. Two mutable parameters, initially zero, are added: ``wind.error``, the
        error of the wind forecast by axis [m/s], and ``power.error``, the relative error of the
        power model.

    Examples
    --------
    >>> gusty = scenario.replace({"wind": {"turbulence": {"intensity": "light"}}})
    >>> m = build_in_turbulence(gusty)
    >>> m.find_component("wind.turbulence").name
    'wind.turbulence'
    """
    m = _vehicle_in_the_wind(scenario)
    turbulence.declare_turbulence(m, scenario)
    aerodynamics.declare_aerodynamics(m, scenario)
    declare_balances(m, scenario)
    power.declare_power(m, scenario)
    power.declare_error(m)
    _declare_cost_and_limits(m, scenario)
    return m


def build_remaining(scenario: Scenario) -> ConcreteModel:
    """Build the model of the rest of a mission from a measured state, for replanning in flight.

    Parameters
    ----------
    scenario : Scenario
        The mission, with the wind as currently forecast.

    Returns
    -------
    ConcreteModel
        The model of `build_model` with four differences:

        - The states at the start are mutable parameters of block `start`.
        - The flight ends in steady hover, tilted against the wind.
        - The mutable parameter `aerodynamics.unexplained` [m/s^2], initially zero, is added to the
          horizontal acceleration. During the flight, the planner sets it to the observed
          acceleration less the modelled acceleration.
        - Most limits are soft: a flight may violate them, but each violation adds a penalty to the
          objective. See `model.soft_limits`, which names the hard limits.

    Examples
    --------
    >>> m = build_remaining(scenario)
    >>> m.find_component("aerodynamics.unexplained").name
    'aerodynamics.unexplained'
    """
    m = _vehicle_in_the_wind(scenario)
    aerodynamics.declare_aerodynamics(m, scenario)
    aerodynamics.declare_unexplained(m)
    _declare_flight(m, scenario)
    mission.start_where_measured(m)
    mission.end_in_equilibrium(m)
    soft_limits.soften(m, scenario)
    return m


def _vehicle_in_the_wind(scenario: Scenario) -> ConcreteModel:
    """Return a new, incomplete model with time, vehicle, rotors, rigid body, ground and wind.

    The callers add the forces and all further components.
    """
    m = ConcreteModel(name=scenario.name)
    *passages, duration = scenario.nominal_times
    inside = sorted(set(passages)) or [duration / 2]
    m.time = ContinuousSet(initialize=(0.0, *inside, duration), doc="time [s]")
    m.clock = Param(
        m.time,
        initialize=lambda _m, t: t,
        mutable=True,
        units=units.s,
        doc="time as a term of an equation",
    )
    m.scaling_factor = Suffix(direction=Suffix.EXPORT)
    vehicle.declare_vehicle(m, scenario)
    # Declared first, because blocks declared before the wind's equations may depend on it.
    m.wind = Block(doc="wind, Yacef et al., eqs. (11) and (12)")
    rotors.declare_rotors(m, scenario)
    rotors.declare_motors(m, scenario)
    declare_motion(m, scenario)
    ground.declare_ground(m, scenario)
    wind.declare_wind(m, scenario)
    return m


def _declare_flight(m: ConcreteModel, scenario: Scenario) -> None:
    """Complete a model that has forces and wind: declare balances, power, limits and cost."""
    declare_balances(m, scenario)
    power.declare_power(m, scenario)
    _declare_cost_and_limits(m, scenario)


def _declare_cost_and_limits(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare battery, limits, conditions at start, goal and waypoints, and the objective [J].

    For missions that minimise the charge, see docs/theory/battery.md, eq. (12).
    """
    battery.declare_battery(m, scenario)
    limits.declare_limits(m, scenario)
    airspace.declare_airspace(m, scenario)
    homing.declare_homing(m, scenario)
    mission.declare_mission(m, scenario)
    # A lambda, because Integral rewrites its rule's signature and cannot handle annotations.
    m.energy = Integral(
        m.time, wrt=m.time, rule=lambda m, t: m.power.total[t], doc="Yacef et al., eq. (8) [J]"
    )
    cost, doc = m.energy, "Yacef et al., eq. (8): energy of the flight"
    if scenario.mission.aim is Aim.CHARGE:
        battery.declare_loss(m)
        cost, doc = cost + m.battery.loss[m.time.last()], f"{doc}, energy lost inside its pack"
    if scenario.mission.is_free:
        mission.declare_duration(m, scenario)
        cost, doc = cost + m.mission.price_of_time * m.duration, f"{doc}, and price of its duration"
    m.objective = Objective(expr=cost, sense=minimize, doc=f"{doc} [J]")


def parameter_values(scenario: Scenario) -> dict[str, float]:
    """Return a scenario's parameter values, to solve a compiled model for another scenario.

    The parameters are those that `model.parameters.parameters_in` registers. The places of the
    waypoints are not among them.

    Parameters
    ----------
    scenario : Scenario
        Scenario whose values are returned. They fit the model of another scenario if the function
        `structure_key` returns equal keys for both.

    Returns
    -------
    dict of str to float
        Full component name, as ``"wind.x.amplitudes[1]"``, to value in the declared unit.

    Examples
    --------
    >>> parameter_values(scenario)["vehicle.gravity"]
    9.81
    """
    return {
        name: value
        for block, table in parameter_tables(scenario)
        for name, value in parameter_items(block, table, scenario)
    }


def structure_key(scenario: Scenario) -> Hashable:
    """Return a key that is equal for scenarios with the same compiled model.

    Parameters
    ----------
    scenario : Scenario
        Any scenario.

    Returns
    -------
    hashable
        If two scenarios have equal keys, the compiled model of one can be solved for the other,
        with the values from `parameter_values`. The scenarios may differ in parameter values, the
        length of a fixed duration, initial guess and scaling. Missions with different waypoints
        have different keys.

    Examples
    --------
    >>> loaded = scenario.replace({"vehicle.payload": 0.1})
    >>> structure_key(loaded) == structure_key(scenario)
    True
    """
    series = scenario.wind.series
    *passages, end = scenario.nominal_times
    # If the plan chooses the times, a table over time has the rows for the longest flight.
    longest = scenario.mission.duration_limits[1] if scenario.mission.is_free else None
    return (
        scenario.model,
        tuple(parameter_values(scenario)),
        scenario.vehicle.attitude,
        scenario.vehicle.rotor_senses,
        scenario.power.model,
        scenario.wind.coupling,
        None if series is None else (series, scenario.wind.time_offset, longest),
        (scenario.wind.grid, scenario.wind.beyond),
        scenario.airspace.ground,
        homing.terrain_key(scenario),
        battery.may_lose_voltage(scenario),
        (scenario.mission, tuple(t / end for t in passages)) if passages else None,
        scenario.mission.aim is Aim.CHARGE,
    )


def guess_key(scenario: Scenario) -> Scenario:
    """Return a key that is equal for scenarios with the same initial guess and variable scaling.

    The key is the scenario without its wind, on which guess and scaling do not depend.
    """
    return scenario.model_copy(update={"wind": None})


def ask_for_least_time(m: ConcreteModel, bounds: tuple[float, float], guess: float) -> Var:
    """Make a mission's model a minimum-time problem: the objective becomes the duration.

    Parameters
    ----------
    m : ConcreteModel
        A mission's model, not yet discretised. If the model already has a variable duration, the
        bounds of this variable are replaced.
    bounds : pair of float
        Least and greatest permitted duration [s].
    guess : float
        Initial guess of the duration [s].

    Returns
    -------
    Var
        The duration, to pass to `collocation.compile` as the end of the time horizon.

    Examples
    --------
    >>> m = build_model(scenario)
    >>> duration = ask_for_least_time(m, bounds=(0.5, 10.0), guess=2.0)
    >>> duration.name
    'duration'
    """
    for objective in m.component_objects(Objective, active=True, descend_into=True):
        objective.deactivate()
    if m.component("duration") is None:
        m.duration = Var(units=units.s, doc="duration [s]")
    m.duration.setlb(bounds[0])
    m.duration.setub(bounds[1])
    m.duration.set_value(guess)
    m.least_time = Objective(expr=m.duration)
    return m.duration


def model_builder(scenario: Scenario, *, is_code_allowed: bool) -> Builder:
    """Return the function that builds the scenario's model: `build_model` or the user's own.

    Parameters
    ----------
    scenario : Scenario
        Scenario whose field ``model`` may name the user's builder as ``file.py:function``, with the
        file relative to the scenario's folder.
    is_code_allowed : bool
        Whether the user agreed to run code from a file.

    Returns
    -------
    callable
        Takes a scenario, returns a ConcreteModel.

    Raises
    ------
    ScenarioError
        If the scenario names a builder and `is_code_allowed` is false, or if the builder cannot be
        loaded.

    Examples
    --------
    >>> model_builder(scenario, is_code_allowed=False) is build_model
    True
    """
    if scenario.model is None:
        return build_model
    if not is_code_allowed:
        raise ScenarioError(
            f"model = {scenario.model!r} runs code from a file; allow it with --allow-code."
        )
    return load_builder(scenario.model, scenario.folder)


def load_builder(spec: str, base_folder: Path) -> Builder:
    """Load a model builder from a Python file.

    Parameters
    ----------
    spec : str
        ``file.py:function``.
    base_folder : Path
        Folder to which a relative file name refers.

    Returns
    -------
    callable
        Takes a scenario, returns a ConcreteModel.

    Raises
    ------
    ScenarioError
        If the file or the function does not exist, or the file raises an exception. The returned
        function raises `ScenarioError`, too, if the user's function fails or returns no
        ConcreteModel.

    Examples
    --------
    >>> code = "from pyomo_quad import build_model as build"
    >>> characters = Path("own.py").write_text(code)
    >>> load_builder("own.py:build", Path())(scenario).find_component("vehicle.mass").name
    'vehicle.mass'
    """
    file_name, _, function_name = spec.rpartition(":")
    module = _run(spec, base_folder / file_name)
    function = getattr(module, function_name, None)
    if not callable(function):
        raise ScenarioError(
            f"model = {spec!r}: {file_name} has no function {function_name}; it must define "
            f"{function_name}(scenario)."
        )

    def build(scenario: Scenario) -> ConcreteModel:
        try:
            model = function(scenario)
        except Exception as error:
            raise ScenarioError(
                f"model = {spec!r}: {function_name} fails: {_one_line(error)}; correct it."
            ) from error
        if not isinstance(model, ConcreteModel):
            raise ScenarioError(
                f"model = {spec!r} returned {type(model).__name__}; it must return a ConcreteModel."
            )
        return model

    return build


def _run(spec: str, file: Path) -> ModuleType:
    """Import the Python file of a user's model builder and return it as a module.

    Error messages quote `spec`, the scenario's text "file.py:function".
    """
    if not file.is_file():
        raise ScenarioError(f"model = {spec!r}: no file {file}; name an existing Python file.")
    module_spec = spec_from_file_location(f"custom_model_{file.stem}", file)
    if module_spec is None or module_spec.loader is None:
        raise ScenarioError(f"model = {spec!r}: {file} is not Python; name a file ending in .py.")
    module = module_from_spec(module_spec)
    try:
        module_spec.loader.exec_module(module)
    except Exception as error:
        raise ScenarioError(
            f"model = {spec!r}: {file} does not run: {_one_line(error)}; correct it."
        ) from error
    return module


def _one_line(error: Exception) -> str:
    """Return an exception as one line: class name and first line of the message."""
    return ": ".join((type(error).__name__, *str(error).splitlines()[:1]))
