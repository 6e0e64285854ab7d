"""What is wrong or doubtful about a mission or its plan, and whether it can be flown at all."""

from collections.abc import Iterator
from math import acos, atan2, cos, hypot, inf, pi, radians, sin
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import Planner
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.flight.flight import ARRIVAL_DISTANCE_M, position_miss, terminal_miss_of
from pyomo_quad.flight.steady import MomentumDemand, SteadyFlight, battery_shortfalls
from pyomo_quad.flight.verification import fly_controls
from pyomo_quad.model import build_model
from pyomo_quad.model.build import Builder
from pyomo_quad.model.screening import Finding, Severity, screen_model
from pyomo_quad.scenario import Attitude, PowerModel, Scenario, describe_fields
from pyomo_quad.scenario.fields import unit_of
from pyomo_quad.scenario.tables import derived_limits
from pyomo_quad.study.certificate import ThrustMoments, certify

if TYPE_CHECKING:
    from pyomo_quad.flight import Plan


def pack_findings(scenario: Scenario, planner: Planner) -> Iterator[Finding]:
    """Yield what the battery cannot give, and which of its limits the flight must break.

    Yields
    ------
    Finding
        A caution where the pack is too small, since its equations stay finite beyond empty;
        impossible where a limit must be broken.
    """
    steady = planner.steady_flight(scenario)
    for line in battery_shortfalls(scenario, steady):
        yield Finding(severity=Severity.CAUTION, subject="battery.use", message=line)
    yield from _charge_at_start(scenario)
    limits = scenario.limits
    is_limited = any(
        limit is not None
        for limit in (
            limits.state_of_charge_min,
            limits.battery_current_max,
            limits.battery_voltage_min,
            limits.battery_power_share_max,
        )
    )
    if is_limited:
        bound = certify(scenario, planner=planner).lower_bound_J
        if bound is not None:
            yield from _limits_broken(scenario, steady, bound)


def _impossible_pack(subject: str, message: str) -> Finding:
    return Finding(severity=Severity.IMPOSSIBLE, subject=subject, message=f"{subject} = {message}")


def _charge_at_start(scenario: Scenario) -> Iterator[Finding]:
    lowest, initial = scenario.limits.state_of_charge_min, scenario.battery.initial_state_of_charge
    if lowest is not None and initial < lowest:
        yield _impossible_pack(
            "limits.state_of_charge_min",
            f"{lowest:.4g} percent; must be at most battery.initial_state_of_charge, "
            f"{initial:.4g} percent.",
        )


def _limits_broken(scenario: Scenario, steady: SteadyFlight, bound: float) -> Iterator[Finding]:
    limits, duration = scenario.limits, scenario.mission.fixed_duration
    current, voltage, charge_rate = steady.pack_under(bound / duration)
    taken = charge_rate * duration
    drawn = 100.0 * taken / steady.pack_capacity
    left = scenario.battery.initial_state_of_charge - drawn
    lowest = limits.state_of_charge_min
    if lowest is not None and left < lowest <= scenario.battery.initial_state_of_charge:
        yield _impossible_pack(
            "limits.state_of_charge_min",
            f"{lowest:.4g} percent: the flight takes at least {taken:.4g} Ah and leaves at most "
            f"{left:.4g} percent; lower the limit or add cells.",
        )
    if limits.battery_current_max is not None and current > limits.battery_current_max:
        yield _impossible_pack(
            "limits.battery_current_max",
            f"{limits.battery_current_max:.4g} A: the mean current of any flight is at least "
            f"{current:.4g} A; raise the limit or add cells in series.",
        )
    if limits.battery_voltage_min is not None and voltage < limits.battery_voltage_min:
        yield _impossible_pack(
            "limits.battery_voltage_min",
            f"{limits.battery_voltage_min:.4g} V: under the mean current the pack has at most "
            f"{voltage:.4g} V; lower the limit or add cells in series.",
        )
    most, share = limits.battery_power_share_max, bound / duration / steady.greatest_pack_power
    if most is not None and share > most:
        yield _impossible_pack(
            "limits.battery_power_share_max",
            f"{most:.4g}: the mean power of any flight is at least {share:.4g} of what the pack "
            "can give; raise the limit or add cells in series.",
        )


# Rotor speeds of a usual flight over that of hover, and how finely they are searched.
_SLOWEST, _FASTEST = 0.6, 1.1
_SPEEDS = 11
_ACCELERATIONS = 16
# A saving below this share of the power is within the rounding of the floors.
_SAVING = 1e-3


def power_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    """Yield where the power model leaves its sound range near the mission's hover."""
    if scenario.power.model is PowerModel.EFFICIENCY:
        yield from _efficiency_findings(scenario, steady)
    yield from _voltage_findings(scenario, steady)


def _caution(subject: str, message: str) -> Finding:
    return Finding(severity=Severity.CAUTION, subject=subject, message=f"{subject} = {message}")


def _efficiency_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    power, acceleration = scenario.power, scenario.limits.rotor_acceleration_max
    if power.regeneration:
        yield _caution(
            "power.regeneration",
            "true: with power.model efficiency braking earns more than it gave, so the least "
            "energy may be unbounded; set it false.",
        )
    hovering = steady.rotor_value("power.efficiency_polynomial", steady.hover_speed)
    if hovering < power.efficiency_floor:
        yield _caution(
            "power.efficiency_floor",
            f"{power.efficiency_floor:.4g}: above f_r = {hovering:.4g} at hover, so the floor and "
            "not f_r sets the energy; lower it.",
        )
    torque = steady.rotor_value("rotors.motor_torque", steady.hover_speed)
    if torque < power.torque_floor:
        yield _caution(
            "power.torque_floor",
            f"{power.torque_floor:.4g} N m: above the torque of hover, {torque:.4g} N m, so f_r is "
            "not read where the flight is; lower it.",
        )
    dearest = _fastest_chattering(steady, acceleration)
    if dearest is not None:
        yield _caution(
            "power.model",
            f"efficiency: at rotor speeds up to {dearest:.3g} rad/s (hover "
            f"{steady.hover_speed:.4g}) speeding up and slowing down in turn costs less than a "
            f"steady speed, so the optimum depends on limits.rotor_acceleration_max = "
            f"{acceleration:.4g} rad/s^2 and on the mesh; compare with power.model motor.",
        )


def _fastest_chattering(steady: SteadyFlight, limit: float) -> float | None:
    """Return the highest usual rotor speed at which changing speed is cheaper than keeping it."""
    hover = steady.hover_speed
    for speed in np.linspace(_FASTEST * hover, _SLOWEST * hover, _SPEEDS):
        # The chord from braking to speeding up, where it passes the steady speed.
        up = np.linspace(0.0, limit, _ACCELERATIONS)[1:]
        faster = steady.rotor_value("power.rotor_power", speed, up)
        slower = steady.rotor_value("power.rotor_power", speed, -up)
        mixed = (up[:, None] * slower + faster[:, None] * up) / (up[:, None] + up)
        keeping = steady.rotor_value("power.rotor_power", speed)
        if mixed.min() < keeping * (1 - _SAVING):
            return float(speed)
    return None


def _voltage_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    hovering = steady.hover
    if hovering.power_W > hovering.greatest_battery_power_W:
        return  # the pack has no voltage under such a load, which is a finding of its own
    pack = hovering.battery_voltage_V
    motor = steady.rotor_value("rotors.motor_voltage", steady.hover_speed)
    if motor > pack:
        yield _caution(
            "battery.cells_series",
            f"{scenario.battery.cells_series}: hover needs {motor:.4g} V at the motors, the pack "
            f"gives {pack:.4g} V; add cells in series.",
        )


# Durations tried, in doublings and then in halvings, to say how long a mission needs.
_DOUBLINGS = 12
_HALVINGS = 8
# The bounds are computed to better than this, relative.
_MARGIN = 1e-3


def reach_findings(scenario: Scenario, planner: Planner) -> Iterator[Finding]:
    """Yield what rules the flight out for want of thrust, tilt, rotor speed or yaw moment."""
    steady = planner.steady_flight(scenario)
    if scenario.limits.rotor_speed_min > steady.hover_speed:
        yield _impossible(
            "limits.rotor_speed_min",
            f"{scenario.limits.rotor_speed_min:.4g} rad/s; must be at most the "
            f"{steady.hover_speed:.4g} rad/s of hover at start and goal.",
        )
        return
    yield from _yaw_findings(scenario, steady)
    if scenario.wind.varies_with_height:
        return  # what the wind asks for depends on the heights that the plan chooses
    demand = MomentumDemand(planner.dynamics(scenario))
    if demand.is_linear:
        yield from _thrust_findings(scenario, steady, demand)


def _impossible(subject: str, message: str) -> Finding:
    return Finding(severity=Severity.IMPOSSIBLE, subject=subject, message=f"{subject} = {message}")


def _available_thrust(scenario: Scenario, steady: SteadyFlight) -> tuple[str, float]:
    """Return the field that limits the thrust most, with its value, and that thrust."""
    limits = scenario.limits
    # Half way through the flight the rotors are furthest from the hover speed of both ends.
    gain = limits.rotor_acceleration_max * scenario.mission.fixed_duration / 2
    candidates = {
        f"limits.rotor_speed_max = {limits.rotor_speed_max:.4g} rad/s": float(
            steady.thrust(limits.rotor_speed_max)
        ),
        f"limits.thrust_max = {limits.thrust_max:.4g} N": limits.thrust_max,
        f"limits.rotor_acceleration_max = {limits.rotor_acceleration_max:.4g} rad/s^2": (
            float(steady.thrust(steady.hover_speed + gain))
        ),
    }
    return min(candidates.items(), key=lambda item: item[1])


def _moments(scenario: Scenario, demand: MomentumDemand, duration: float) -> ThrustMoments:
    mission = scenario.mission
    displacement = np.subtract(mission.goal.position, mission.start.position)
    return ThrustMoments(demand, displacement, duration)


def _thrust_findings(
    scenario: Scenario, steady: SteadyFlight, demand: MomentumDemand
) -> Iterator[Finding]:
    field, available = _available_thrust(scenario, steady)
    duration = scenario.mission.fixed_duration
    moments = _moments(scenario, demand, duration)
    against_wind = float(
        np.linalg.norm(moments.mean_thrust - demand.drag * _mean_velocity(scenario))
    )
    if against_wind > available * (1 + _MARGIN):
        yield _impossible(
            "wind.use",
            f"{scenario.wind.use}: holding against the mean wind needs {against_wind:.4g} N of "
            f"thrust, {field} allows {available:.4g} N; raise the limit or calm the wind.",
        )
        return
    needed = moments.least_peak()
    if needed > available * (1 + _MARGIN):
        yield _too_short(scenario, demand, field, available, needed)
        return
    yield from _tilt_findings(scenario, moments, available)


def _mean_velocity(scenario: Scenario) -> np.ndarray:
    mission = scenario.mission
    return np.subtract(mission.goal.position, mission.start.position) / mission.fixed_duration


def _too_short(
    scenario: Scenario, demand: MomentumDemand, field: str, available: float, needed: float
) -> Finding:
    subject, _, limit = field.partition(" = ")
    if subject == "limits.rotor_acceleration_max":
        return _impossible(
            subject,
            f"{limit}: the mission needs {needed:.4g} N of thrust, the rotors reach "
            f"{available:.4g} N by half time; raise the limit.",
        )
    least = _least_duration(scenario, demand, available)
    remedy = f"; allow more than {least:.3g} s" if least < inf else ""
    return _impossible(
        "mission.duration",
        f"{scenario.mission.fixed_duration:.4g} s: to reach the goal and stop needs {needed:.4g} "
        f"N of thrust, {field} allows {available:.4g} N{remedy}.",
    )


def _least_duration(scenario: Scenario, demand: MomentumDemand, available: float) -> float:
    """Return a duration in which the thrust available is not enough yet, inf if none is."""
    if scenario.wind.series is not None:
        return inf  # the wind beyond the mission is not known

    def is_enough(duration: float) -> bool:
        return _moments(scenario, demand, duration).least_peak() <= available

    short = long = scenario.mission.fixed_duration
    for _ in range(_DOUBLINGS):
        short, long = long, 2 * long
        if is_enough(long):
            break
    else:
        return inf
    for _ in range(_HALVINGS):
        middle = (short + long) / 2
        short, long = (short, middle) if is_enough(middle) else (middle, long)
    return short


def _tilt_findings(
    scenario: Scenario, moments: ThrustMoments, available: float
) -> Iterator[Finding]:
    limits = scenario.limits
    # Of all attitudes allowed, both angles at their limit tilt the thrust furthest.
    largest = acos(cos(limits.roll_max) * cos(limits.pitch_max))
    across, up = hypot(*moments.mean_thrust[:2]), float(moments.mean_thrust[2])
    tilt = atan2(across, up)
    subject = "limits.roll_max" if limits.roll_max < limits.pitch_max else "limits.pitch_max"
    limit = min(limits.roll_max, limits.pitch_max)
    allowed = f"{limit:.4g} rad: roll and pitch together tilt the thrust by {largest:.3g} rad"
    if tilt > largest * (1 + _MARGIN):
        yield _impossible(
            subject,
            f"{allowed}, the mean thrust of the mission must tilt by {tilt:.3g} rad; raise the "
            "limit or calm the wind.",
        )
        return
    sideways = moments.least_peak(axes=(0, 1))
    if largest < pi / 2 and sideways > available * sin(largest) * (1 + _MARGIN):
        yield _impossible(
            subject,
            f"{allowed}, so {available * sin(largest):.3g} N across at full thrust, the mission "
            f"needs {sideways:.3g} N; raise the limit or allow more time.",
        )


def _yaw_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    vehicle, limits, mission = scenario.vehicle, scenario.limits, scenario.mission
    if vehicle.Ix != vehicle.Iy:
        return  # roll and pitch rates together turn the vehicle as well
    moment = min(
        limits.yaw_moment_max, steady.yaw_moment(limits.rotor_speed_max, limits.rotor_speed_min)
    )
    # Full moment one way for half of the time, the other way for the rest.
    reachable = moment / vehicle.Iz * mission.fixed_duration**2 / 4
    turn = abs(mission.goal.yaw - mission.start.yaw)
    if turn > reachable * (1 + _MARGIN):
        needed = 2 * (turn * vehicle.Iz / moment) ** 0.5
        yield _impossible(
            "mission.goal.yaw",
            f"{mission.goal.yaw:.4g} rad: in {mission.fixed_duration:.4g} s a yaw moment of "
            f"{moment:.3g} N m turns by at most {reachable:.3g} rad, the mission turns by "
            f"{turn:.3g} rad; turn less or allow more than {needed:.3g} s.",
        )


_ROUNDING = 1e-9


def diagnose(
    scenario: Scenario, *, builder: Builder = build_model, planner: Planner | None = None
) -> tuple[Finding, ...]:
    """List what the mission must break and what deserves a second look.

    Parameters
    ----------
    builder : callable, optional
        Makes the Pyomo model. Of a model of the user's own the declarations alone are looked at:
        what its vehicle can do is not known.

    Returns
    -------
    tuple of Finding
        The impossible first; empty when nothing was found, which proves nothing.
    """
    told = scenario.as_forecast()
    findings = list(_angles_in_degrees(scenario))
    planner = planner or Planner(builder)
    if planner.builder is build_model:
        if not told.mission.is_free:  # what only more time would mend is the plan's to choose
            findings += reach_findings(told, planner)
            findings += pack_findings(told, planner)
        findings += power_findings(told, planner.steady_flight(told))
        findings += _idle_limits(told)
    findings += _beyond_measured_heights(told)
    findings += screen_model(planner.model(told))
    return tuple(sorted(findings, key=lambda f: f.severity is not Severity.IMPOSSIBLE))


def _angles_in_degrees(scenario: Scenario) -> Iterator[Finding]:
    """Yield angles of more than a turn."""
    for field in describe_fields(scenario):
        if field.unit == "rad" and isinstance(field.value, float) and abs(field.value) > 2 * pi:
            degrees = field.value
            yield Finding(
                severity=Severity.CAUTION,
                subject=field.path,
                message=f"{field.path} = {degrees:g} rad is {abs(degrees) / (2 * pi):.3g} turns; "
                f"were degrees meant? {degrees:g} degrees are {radians(degrees):.4g} rad.",
            )


def _beyond_measured_heights(scenario: Scenario) -> Iterator[Finding]:
    """Say of a wind measured over heights where the mission goes beyond them."""
    series = scenario.wind.series
    heights = () if series is None else series.heights
    flown = [place[2] for place in scenario.mission.positions]
    if heights and not heights[0] <= min(flown) <= max(flown) <= heights[-1]:
        yield Finding(
            severity=Severity.CAUTION,
            subject="wind.file",
            message=f"wind.file = {scenario.wind.file} is of {heights[0]:g} to {heights[-1]:g} m, "
            f"the mission goes from {min(flown):g} to {max(flown):g} m; beyond, the wind is held "
            "as it is at the nearest height: give the heights that are flown.",
        )


def _idle_limits(scenario: Scenario) -> Iterator[Finding]:
    """Yield limits that the rotors cannot reach."""
    limits = scenario.limits
    reachable = derived_limits(scenario.vehicle, limits.rotor_speed_max)
    for name, greatest in reachable.items():
        limit = getattr(limits, name)
        if limit > greatest * (1 + _ROUNDING):
            unit = unit_of(type(limits), name).replace("*", " ")
            yield Finding(
                severity=Severity.CAUTION,
                subject=f"limits.{name}",
                message=f"limits.{name} = {limit:.4g} {unit}: never reached, rotors at "
                f"limits.rotor_speed_max give {greatest:.4g} {unit}; leave it out.",
            )


_TORQUE = "rotors.motor_torque"
_EFFICIENCY = "power.efficiency_polynomial"


def plan_cautions(plan: "Plan", *, planner: "Planner | None" = None) -> tuple[str, ...]:
    """Say what stands between a plan and its being taken at its word."""
    has_flown = plan.verification is not None
    findings = diagnose(plan.mission_flown if has_flown else plan.scenario, planner=planner)
    told = tuple(finding.message for finding in findings)
    solved = () if plan.solution is None else plan.solution.warnings
    doubts = (*_efficiency_map_cautions(plan.scenario, plan), *_attitude_cautions(plan, planner))
    return (*told, *solved, *doubts)


def _attitude_cautions(plan: "Plan", planner: "Planner | None") -> tuple[str, ...]:
    """Say where a plan ends that takes body rates for Euler rates, if it does not arrive."""
    told = plan.scenario.as_forecast()
    is_printed = told.vehicle.attitude is Attitude.PAPER
    if not is_printed or plan.solution is None or plan.verification is None:
        return ()
    vehicle = told.vehicle.model_copy(update={"attitude": Attitude.EULER})
    exact = (planner or Planner()).dynamics(told.model_copy(update={"vehicle": vehicle}))
    held = plan.trajectories
    planned = dict(zip(held.state_names, held.states[-1].tolist(), strict=True))
    try:
        flown = fly_controls(exact, held.mesh, held.controls, held.states[0], held.horizon)
    except SolveError:
        miss = inf
    else:
        miss = position_miss(terminal_miss_of(exact, flown.states[-1], planned))
    if miss <= ARRIVAL_DISTANCE_M:
        return ()
    astray = (
        f'vehicle.attitude = "paper": its body rates taken for Euler rates hold for this plan no '
        f"longer: flown with exact attitude it ends {miss:.3g} m astray, more than "
        f'{ARRIVAL_DISTANCE_M:g} m; set vehicle.attitude = "euler".'
    )
    return (astray,)


def _efficiency_map_cautions(scenario: Scenario, plan: "Plan") -> tuple[str, ...]:
    is_read = scenario.power.model is PowerModel.EFFICIENCY and plan.dynamics.has(_EFFICIENCY)
    if not is_read:
        return ()
    held = plan.trajectories
    times = held.node_times[1:]
    keys = tuple((name, rotor) for name in (_TORQUE, _EFFICIENCY) for rotor in ROTORS)
    values = plan.dynamics.table(keys, times, held.states[1:], held.controls)
    torque, efficiency = np.hsplit(values, 2)
    floors = scenario.power
    outside = (torque < floors.torque_floor) | (efficiency < floors.efficiency_floor)
    if not outside.any():
        return ()
    caution = (
        f"power.model efficiency: {100 * outside.mean():.0f} % of the plan's rotor states lie "
        f"outside f_r's sound range (torque below {floors.torque_floor:g} N m or f_r below "
        f"{floors.efficiency_floor:g}); the energy there is that of the floors, not of the paper."
    )
    return (caution,)
