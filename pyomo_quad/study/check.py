"""Checks of a mission before the solve, and cautions about a plan after the solve.

The argument `planner` supplies a scenario's model and its compiled equations, and keeps them for
later calls. It plans no flight here.
"""

from collections.abc import Iterator
from math import atan2, hypot, inf, pi, radians, sin
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import Planner
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.flight.controller import followed_tilt
from pyomo_quad.flight.deadline import TimeIsUpError
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


def _impossible(subject: str, message: str) -> Finding:
    return Finding(severity=Severity.IMPOSSIBLE, subject=subject, message=f"{subject} = {message}")


def _caution(subject: str, message: str) -> Finding:
    return Finding(severity=Severity.CAUTION, subject=subject, message=f"{subject} = {message}")


def pack_findings(scenario: Scenario, planner: Planner) -> Iterator[Finding]:
    """Yield findings on a battery with too little charge or power for a mission of fixed duration.

    A finding is "impossible" if the initial charge is below the least allowed charge. It is also
    "impossible" if even a flight that takes only the lower bound on the energy, from `certify`,
    breaks a limit. Other findings are cautions.
    """
    steady, limits = planner.steady_flight(scenario), scenario.limits
    # Only a caution: the battery's equations stay finite for an empty battery.
    for line in battery_shortfalls(scenario, steady):
        yield Finding(severity=Severity.CAUTION, subject="battery.use", message=line)
    lowest, initial = limits.state_of_charge_min, scenario.battery.initial_state_of_charge
    if lowest is not None and initial < lowest:
        yield _impossible(
            "limits.state_of_charge_min",
            f"{lowest:.4g} percent; must be at most battery.initial_state_of_charge, "
            f"{initial:.4g} percent.",
        )
    of_the_pack = (
        lowest,
        limits.battery_current_max,
        limits.battery_voltage_min,
        limits.battery_power_share_max,
    )
    if any(limit is not None for limit in of_the_pack):
        bound = certify(scenario, planner=planner).lower_bound_J
        if bound is not None:
            yield from _limits_broken(scenario, steady, bound)


def _limits_broken(scenario: Scenario, steady: SteadyFlight, bound: float) -> Iterator[Finding]:
    """Yield a finding for each battery limit that every flight breaks.

    `bound` is a lower bound on the energy of every flight [J].
    """
    limits, duration = scenario.limits, scenario.mission.fixed_duration
    # A limit broken at the least mean power (bound / duration) is broken by every flight.
    current, voltage, charge_rate = steady.pack_under(bound / duration)
    taken, initial = charge_rate * duration, scenario.battery.initial_state_of_charge
    left = initial - 100.0 * taken / steady.pack_capacity
    share = bound / duration / steady.greatest_pack_power
    lowest, most = limits.state_of_charge_min, limits.battery_current_max
    least, greatest = limits.battery_voltage_min, limits.battery_power_share_max
    if lowest is not None and left < lowest <= initial:
        yield _impossible(
            "limits.state_of_charge_min",
            f"{lowest:.4g} percent: the flight takes at least {taken:.4g} Ah and leaves at most "
            f"{left:.4g} percent; lower the limit or add cells.",
        )
    if most is not None and current > most:
        yield _impossible(
            "limits.battery_current_max",
            f"{most:.4g} A: the mean current of any flight is at least {current:.4g} A; raise the "
            "limit or add cells in series.",
        )
    if least is not None and voltage < least:
        yield _impossible(
            "limits.battery_voltage_min",
            f"{least:.4g} V: under the mean current the pack has at most {voltage:.4g} V; lower "
            "the limit or add cells in series.",
        )
    if greatest is not None and share > greatest:
        yield _impossible(
            "limits.battery_power_share_max",
            f"{greatest:.4g}: the mean power of any flight is at least {share:.4g} of the pack's "
            "greatest power; raise the limit or add cells in series.",
        )


# Range of rotor speeds, relative to hover, that is searched for chattering: the speeds of usual
# flights.
_SLOWEST, _FASTEST = 0.6, 1.1
_SPEEDS = 11  # samples of this range: 5 % of the hover speed apart
_ACCELERATIONS = 16  # samples of the rotor acceleration from zero to its limit, for each sign
# A relative saving below this is within the smoothing of the lower limits of torque and f_r.
_SAVING = 1e-3


def power_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    """Yield findings on the power model `efficiency`, and on the motor voltage in hover.

    Findings on `efficiency` are cautions. Too low a battery voltage for hover is "impossible" with
    the models `motor` and `motor_with_friction`, a caution with all others.
    """
    if scenario.power.model is PowerModel.EFFICIENCY:
        yield from _efficiency_findings(scenario, steady)
    yield from _voltage_findings(scenario, steady)


def _efficiency_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    power, acceleration = scenario.power, scenario.limits.rotor_acceleration_max
    if power.regeneration:
        yield _caution(
            "power.regeneration",
            "true: with power.model efficiency braking returns more energy than it absorbs, so "
            "the least energy may be unbounded; set it false.",
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
            f"{steady.hover_speed:.4g}) alternating acceleration and braking costs less than a "
            f"steady speed, so the optimum depends on limits.rotor_acceleration_max = "
            f"{acceleration:.4g} rad/s^2 and on the mesh; compare with power.model motor.",
        )


def _fastest_chattering(steady: SteadyFlight, limit: float) -> float | None:
    """Return the highest rotor speed [rad/s] at which chattering saves power.

    Chattering alternates acceleration and braking, each at most `limit` [rad/s^2]. The result is
    None if chattering saves power at none of the speeds tried.
    """
    hover = steady.hover_speed
    # Where chattering takes less power, a plan of least energy chatters. The plan then depends on
    # the limit and on the mesh.
    for speed in np.linspace(_FASTEST * hover, _SLOWEST * hover, _SPEEDS):
        # Mean power of alternating acceleration and braking: the chord at zero acceleration.
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
        return  # the pack has no voltage under this load: `battery_shortfalls` reports it
    pack = hovering.battery_voltage_V
    if scenario.vehicle.motor is None:
        return
    # The other models do not use the motors' electrical constants, which may be unknown.
    is_counted = scenario.power.model in (PowerModel.MOTOR, PowerModel.MOTOR_WITH_FRICTION)
    name = "power.terminal_voltage" if is_counted else "rotors.motor_voltage"
    motor = steady.rotor_value(name, steady.hover_speed)
    if motor > pack:
        say = _impossible if is_counted else _caution
        yield say(
            "battery.cells_series",
            f"{scenario.battery.cells_series}: hover needs {motor:.4g} V at the motors, the pack "
            f"gives {pack:.4g} V; add cells in series.",
        )


# Search for the duration that a mission needs: doubling up to 4096 times the given duration, then
# bisection to 1/256 of the last step.
_DOUBLINGS = 12
_HALVINGS = 8
# Relative margin beyond which a demand exceeds a limit; quadrature of the bounds errs by some 1e-4.
_MARGIN = 1e-3


def reach_findings(scenario: Scenario, planner: Planner) -> Iterator[Finding]:
    """Yield findings on limits on the motion that every flight of a mission exceeds.

    The duration must be fixed. The limits are those on rotor speed, rotor acceleration, thrust,
    tilt and yaw moment. Each finding proves that no flight of the mission exists.
    """
    steady = planner.steady_flight(scenario)
    if scenario.limits.rotor_speed_min > steady.hover_speed:
        yield _impossible(
            "limits.rotor_speed_min",
            f"{scenario.limits.rotor_speed_min:.4g} rad/s; must be at most the "
            f"{steady.hover_speed:.4g} rad/s of hover at start and goal.",
        )
        return
    yield from _yaw_findings(scenario, steady)
    if scenario.wind.varies_with_place:
        return  # the thrust needed depends on the route that the plan chooses
    demand = MomentumDemand(planner.dynamics(scenario))
    # Thrust and tilt are checked only if the drag is linear.
    if demand.is_linear:
        yield from _thrust_findings(scenario, steady, demand)


def _available_thrust(scenario: Scenario, steady: SteadyFlight) -> tuple[str, float]:
    """Return the strictest limit on the thrust as text, and the largest thrust that it permits [N].

    The limits are those on rotor speed, thrust and rotor acceleration. The rotors start and end at
    hover speed, so a limit on their acceleration limits their speed.
    """
    limits = scenario.limits
    # Rotors start and end at hover speed, so they can be fastest half way through the flight, by
    # at most limit * duration / 2 above hover speed.
    gain = limits.rotor_acceleration_max * scenario.mission.fixed_duration / 2
    speed, acceleration = limits.rotor_speed_max, limits.rotor_acceleration_max
    candidates = (
        (f"limits.rotor_speed_max = {speed:.4g} rad/s", float(steady.thrust(speed))),
        (f"limits.thrust_max = {limits.thrust_max:.4g} N", limits.thrust_max),
        (
            f"limits.rotor_acceleration_max = {acceleration:.4g} rad/s^2",
            float(steady.thrust(steady.hover_speed + gain)),
        ),
    )
    return min(candidates, key=lambda candidate: candidate[1])


def _way(scenario: Scenario) -> np.ndarray:
    mission = scenario.mission
    return np.subtract(mission.goal.position, mission.start.position)


def _thrust_findings(
    scenario: Scenario, steady: SteadyFlight, demand: MomentumDemand
) -> Iterator[Finding]:
    field, available = _available_thrust(scenario, steady)
    duration = scenario.mission.fixed_duration
    moments = ThrustMoments(demand, _way(scenario), duration)
    against_wind = moments.mean_thrust - demand.drag * _way(scenario) / duration
    holding = float(np.linalg.norm(against_wind))
    if holding > available * (1 + _MARGIN):
        yield _impossible(
            "wind.use",
            f"{scenario.wind.use}: holding against the mean wind needs {holding:.4g} N of "
            f"thrust, {field} allows {available:.4g} N; raise the limit or calm the wind.",
        )
        return
    needed = moments.least_peak()
    if needed > available * (1 + _MARGIN):
        yield _too_short(scenario, demand, field, available, needed)
        return
    yield from _tilt_findings(scenario, moments, available)


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
    """Return a duration [s] below which the thrust `available` [N] is too small for the mission.

    Call it only if the mission's own duration is too short. `demand` gives the thrust of a motion.
    The result is infinite if all durations tried are too short. It is also infinite if the wind is
    a measured series.
    """
    # After the end of the mission, a measured wind is unknown: no longer duration can be tried.
    if scenario.wind.series is not None:
        return inf

    def is_enough(duration: float) -> bool:
        return ThrustMoments(demand, _way(scenario), duration).least_peak() <= available

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
    # The allowed attitude with the largest tilt has roll and pitch at their limits.
    largest = limits.largest_tilt
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
        return  # the product of roll and pitch rates turns the vehicle in yaw as well
    moment = min(
        limits.yaw_moment_max, steady.yaw_moment(limits.rotor_speed_max, limits.rotor_speed_min)
    )
    # The fastest turn from rest to rest: full moment one way for half of the time, then the other.
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


# Relative excess over a derived limit that counts as rounding.
_ROUNDING = 1e-9


def check_mission(
    scenario: Scenario, *, builder: Builder = build_model, planner: Planner | None = None
) -> tuple[Finding, ...]:
    """Return findings on impossible or doubtful settings of a mission, without a solve.

    Findings which prove that no flight exists come first. Even without findings, the mission may be
    impossible. The wind is the forecast, if there is one. By default, a new planner makes the model
    with `builder`. If `planner` is given, `builder` is ignored.
    """
    told = scenario.as_forecast()
    findings = [*_contradictions(scenario), *_angles_in_degrees(scenario)]
    planner = planner or Planner(builder)
    # The limits of the vehicle in a user's model are unknown.
    if planner.builder is build_model:
        if not told.mission.is_free:  # a plan of free duration takes the time that it needs
            findings += reach_findings(told, planner)
            findings += pack_findings(told, planner)
        findings += power_findings(told, planner.steady_flight(told))
        findings += _idle_limits(told)
        findings += _tilt_left_to_plans(told)
    findings += _beyond_measured_heights(told)
    findings += screen_model(planner.model(told))
    return tuple(sorted(findings, key=lambda f: list(Severity).index(f.severity)))


def _contradictions(scenario: Scenario) -> Iterator[Finding]:
    """Yield a finding for each contradiction between numbers of a scenario's vehicle.

    An example is a moment of inertia that exceeds the sum of the other two.
    """
    for found in scenario.contradictions:
        yield Finding(severity=Severity.UNPHYSICAL, subject=found.field, message=found.message)


def _angles_in_degrees(scenario: Scenario) -> Iterator[Finding]:
    """Yield a caution for each angle of more than one turn, probably meant in degrees."""
    for field in describe_fields(scenario):
        if field.unit == "rad" and isinstance(field.value, float) and abs(field.value) > 2 * pi:
            degrees = field.value
            yield _caution(
                field.path,
                f"{degrees:g} rad is {abs(degrees) / (2 * pi):.3g} turns; were degrees meant? "
                f"{degrees:g} degrees are {radians(degrees):.4g} rad.",
            )


def _beyond_measured_heights(scenario: Scenario) -> Iterator[Finding]:
    """Yield a caution if the mission leaves the heights at which its wind was measured."""
    series = scenario.wind.series
    heights = () if series is None else series.heights
    flown = [place[2] for place in scenario.mission.positions]
    if heights and not heights[0] <= min(flown) <= max(flown) <= heights[-1]:
        yield _caution(
            "wind.file",
            f"{scenario.wind.file} covers {heights[0]:g} to {heights[-1]:g} m, the mission goes "
            f"from {min(flown):g} to {max(flown):g} m; outside, the wind is that of the nearest "
            "height: add the heights of the mission to the file.",
        )


def _idle_limits(scenario: Scenario) -> Iterator[Finding]:
    """Yield a caution for each limit on thrust or moment that the rotors cannot reach.

    Such a limit has no effect: even at their largest speed, the rotors give less.
    """
    limits = scenario.limits
    for name, greatest in derived_limits(scenario.vehicle, limits.rotor_speed_max).items():
        limit, unit = getattr(limits, name), unit_of(type(limits), name).replace("*", " ")
        if limit > greatest * (1 + _ROUNDING):
            yield _caution(
                f"limits.{name}",
                f"{limit:.4g} {unit}: never reached, rotors at limits.rotor_speed_max give "
                f"{greatest:.4g} {unit}; leave it out.",
            )


def _tilt_left_to_plans(scenario: Scenario) -> Iterator[Finding]:
    """Yield a caution if plans of a scenario may tilt further than its controller can follow.

    Limits on roll, pitch and thrust apply to plans, `baseline.gains.tilt_max` to the controller.
    """
    given, without = scenario.baseline.gains.tilt_max, {"baseline.gains.tilt_max": None}
    allowed = followed_tilt(scenario.with_values(without)) if given is not None else 0.0
    if given is not None and given < allowed * (1 - _ROUNDING):
        yield _caution(
            "baseline.gains.tilt_max",
            f"{given:.4g} rad: plans may tilt by {allowed:.4g} rad, as limits.roll_max, "
            "limits.pitch_max and the thrust allow, and the controller would fall behind; leave it "
            "out.",
        )


def _untracked_tilt(plan: "Plan") -> Iterator[str]:
    """Yield a caution if a plan tilts further than the controller of its scenario can follow.

    A simulated flight under this controller would then deviate from the plan.
    """
    held = plan.trajectories
    if plan.verification is None or not set(_ANGLES) <= set(held.state_names):
        return
    roll, pitch = (held.states[:, held.state_names.index(name)] for name in _ANGLES)
    tilt = float(np.arccos(np.cos(roll) * np.cos(pitch)).max())
    most = followed_tilt(plan.scenario)
    if tilt > most + _SAME_TILT:
        yield (
            f"the plan tilts by up to {tilt:.4g} rad, the controller by at most {most:.4g} rad, "
            "so flights under feedback fall behind; raise baseline.gains.tilt_max, or lower "
            "limits.roll_max and limits.pitch_max."
        )


_ANGLES = "rigid_body.phi", "rigid_body.theta"
# Tilt [rad] by which a plan may briefly exceed the controller's limit without a flight lagging.
_SAME_TILT = 0.02

_TORQUE = "rotors.motor_torque"
_EFFICIENCY = "power.efficiency_polynomial"


def plan_cautions(plan: "Plan", *, planner: "Planner | None" = None) -> tuple[str, ...]:
    """Return cautions about a plan, one line each: on its mission, its solve and its flight.

    Those on the flight concern the efficiency map, the simplified attitude equations, and tilts
    beyond the controller's limit. The solve of the plan may have failed. By default, a new planner
    compiles the equations.
    """
    has_flown = plan.verification is not None
    findings = check_mission(plan.mission_flown if has_flown else plan.scenario, planner=planner)
    return (
        *(finding.message for finding in findings),
        *(() if plan.solution is None else plan.solution.warnings),
        *_efficiency_map_cautions(plan),
        *_attitude_cautions(plan, planner),
        *_untracked_tilt(plan),
    )


def _attitude_cautions(plan: "Plan", planner: "Planner | None") -> Iterator[str]:
    """Yield a caution if a plan with the attitude equations of Yacef et al. misses the goal.

    The plan is simulated with the exact equations.
    """
    told = plan.scenario.as_forecast()
    is_printed = told.vehicle.attitude is Attitude.PAPER
    if not is_printed or plan.solution is None or plan.verification is None:
        return
    # Simulate the plan with the exact relation between Euler rates and body rates; the equations
    # of Yacef et al. equate the two.
    vehicle = told.vehicle.model_copy(update={"attitude": Attitude.EULER})
    exact = (planner or Planner()).dynamics(told.model_copy(update={"vehicle": vehicle}))
    held = plan.trajectories
    planned = dict(zip(held.state_names, held.states[-1].tolist(), strict=True))
    try:
        flown = fly_controls(exact, held.mesh, held.controls, held.states[0], held.horizon)
    except TimeIsUpError as error:
        yield f"the plan could not be flown with exact attitude: {error}"
        return
    except SolveError:
        miss = inf
    else:
        miss = position_miss(terminal_miss_of(exact, flown.states[-1], planned))
    if miss > ARRIVAL_DISTANCE_M:
        yield (
            'vehicle.attitude = "paper": equating body rates and Euler rates is not accurate '
            f"enough for this plan: flown with exact attitude it misses the goal by {miss:.3g} m, "
            f'more than {ARRIVAL_DISTANCE_M:g} m; set vehicle.attitude = "euler".'
        )


def _efficiency_map_cautions(plan: "Plan") -> Iterator[str]:
    """Yield a caution if part of a plan is outside the valid range of the polynomial f_r.

    f_r is the efficiency of motor and rotor. It is valid if the torque is at least
    `power.torque_floor` of the scenario, and f_r at least `power.efficiency_floor`.
    """
    floors = plan.scenario.power
    if floors.model is not PowerModel.EFFICIENCY or not plan.dynamics.has(_EFFICIENCY):
        return
    held = plan.trajectories
    keys = tuple((name, rotor) for name in (_TORQUE, _EFFICIENCY) for rotor in ROTORS)
    values = plan.dynamics.table(keys, held.node_times[1:], held.states[1:], held.controls)
    torque, efficiency = np.hsplit(values, 2)
    outside = (torque < floors.torque_floor) | (efficiency < floors.efficiency_floor)
    if outside.any():
        yield (
            f"power.model efficiency: {100 * outside.mean():.0f} % of the plan's rotor states lie "
            f"outside the valid range of f_r (torque below {floors.torque_floor:g} N m or f_r "
            f"below {floors.efficiency_floor:g}); the energy there follows from the floors, not "
            "from the paper."
        )
