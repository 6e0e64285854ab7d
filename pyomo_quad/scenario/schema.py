"""The scenario: all inputs of one mission, validated, immutable and in SI units."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import dist, sqrt
from pathlib import Path as FilePath
from types import MappingProxyType
from typing import Any, Self

from pydantic import BaseModel, PrivateAttr, ValidationError

from pyomo_quad.scenario.airspace import Airspace
from pyomo_quad.scenario.battery import Battery
from pyomo_quad.scenario.fields import (
    Number,
    Part,
    Text,
    late_quantity,
    leaves,
    parse_path,
    positive,
    quantity,
    spell,
    title_field,
    unit_of,
)
from pyomo_quad.scenario.messages import (
    FeasibilityError,
    ScenarioError,
    complaints,
    listed,
    shown,
)
from pyomo_quad.scenario.mission import Mission, Yaw
from pyomo_quad.scenario.plausibility import (
    Contradiction,
    contradictions,
    created_power,
    remarks,
)
from pyomo_quad.scenario.resolution import ScenarioSource, message_origin, resolve
from pyomo_quad.scenario.tables import (
    USED_BY,
    Baseline,
    CruiseSettings,
    Limits,
    Power,
    PowerModel,
    Solver,
)
from pyomo_quad.scenario.unit_keys import Rewritten, in_declared_units, paths_in_declared_units
from pyomo_quad.scenario.vehicle import Attitude, Vehicle
from pyomo_quad.scenario.wind import Air, Wind, WindCoupling

# Estimate of a free duration: least acceleration, as a fraction of gravity; ratio of the estimate
# to the duration of the quickest flight; and least value of distance over acceleration [s²].
_LEAST_LIFT = 0.1
_UNHURRIED = 2.0
_SHORTEST_WAY = 1e-2
# Names become folder names: they have no separator and no leading dot, and so cannot lead out of
# the output folder.
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
_MODEL_PATTERN = r"^[^:\x00]+\.py:[A-Za-z_][A-Za-z0-9_]*$"


class Scenario(Part):
    """Mission with vehicle, battery, wind, power model, limits, solver and baseline flights."""

    name: Text = quantity(
        "",
        "short name, also of the output folder",
        pattern=NAME_PATTERN,
        allowed="1 to 64 letters, digits, '_', '-' or '.', starting with a letter or digit",
        example='"delivery"',
    )
    title: Text = title_field("title of the report", "")
    gravity: Number = quantity(
        "m/s^2",
        "acceleration of gravity",
        9.81,
        sound=positive(0.1, 100, "9.81 on earth, 1.62 on the moon, 24.8 on Jupiter"),
    )
    model: Text | None = quantity(
        "",
        "own model builder as file.py:function, needs --allow-code",
        None,
        pattern=_MODEL_PATTERN,
        allowed="file.py:function",
    )
    vehicle: Vehicle = quantity("", "the vehicle")
    limits: Limits = quantity("", "limits of the flight")
    battery: Battery = quantity("", "the battery pack")
    wind: Wind = quantity("", "the wind")
    power: Power = quantity("", "the power model", Power())
    mission: Mission = quantity("", "the mission")
    air: Air = late_quantity("", "the air, in which a vehicle's numbers change", Air())
    airspace: Airspace = late_quantity("", "where the flight may be", Airspace())
    solver: Solver = quantity("", "solver settings", Solver())
    baseline: Baseline = quantity("", "the controller to compare with", Baseline())

    _origin: ScenarioSource | None = PrivateAttr(None)
    _provenance: Mapping[str, str] = PrivateAttr(default_factory=dict)

    @classmethod
    def from_origin(cls, origin: ScenarioSource) -> Self:
        """Make a complete, validated scenario from the tables and overrides that a user wrote.

        Parameters
        ----------
        origin : ScenarioSource
            Tables of the scenario file, and overrides.

        Returns
        -------
        Scenario
            The complete scenario.

        Raises
        ------
        ScenarioError
            If fields are unknown, missing or out of range; the message has one line for each.
        FeasibilityError
            If the rotors cannot lift the vehicle.
        """
        origin, rewritten = _in_declared_units(origin, cls)
        resolution = resolve(origin, cls)
        lines = [*rewritten.complaints, *resolution.complaints]
        try:
            scenario = cls.model_validate(resolution.tables)
        except ValidationError as error:
            spared = [*resolution.unfilled, *rewritten.unread]
            for path, line in complaints(error, cls, spared=spared):
                said = rewritten.spellings.get(path)
                given = f" It was given as {said}." if said else ""
                lines.append(
                    f"{message_origin(origin, resolution.provenance, path)}: {line}{given}"
                )
        if lines:
            raise ScenarioError(listed(lines))
        scenario._origin = origin  # noqa: SLF001
        scenario._provenance = resolution.provenance  # noqa: SLF001
        scenario._check(origin.source)  # noqa: SLF001
        return scenario

    def __eq__(self, other: object) -> bool:
        # Only values count, not their origin (file, library, default).
        return isinstance(other, Scenario) and self.__dict__ == other.__dict__

    def __hash__(self) -> int:
        return hash(tuple(self.__dict__.values()))

    @property
    def provenance(self) -> Mapping[str, str]:
        """Origin of each field's value, by dotted path.

        An origin is ``default``, ``scenario`` (the scenario file), ``library NAME``, ``--set`` (an
        override) or ``file NAME`` (a data file). For a derived value it is a text such as
        ``1 / torque_constant``.
        """
        everywhere = {spell(path): "default" for path, _ in leaves(self.model_dump())}
        return MappingProxyType(everywhere | dict(self._provenance))

    @property
    def folder(self) -> FilePath:
        """Folder to which the scenario's relative file names refer."""
        return self._origin.folder if self._origin is not None else FilePath()

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """Return a validated copy of the scenario with some fields changed.

        Limits and other values that depend on a changed field are computed again. If the scenario
        was read from a report or a plan file, its limits are stored values and stay unchanged.

        Parameters
        ----------
        values : mapping
            New value of each field by dotted path; ``mission.goal.position[2]`` sets one number of
            a list.

        Returns
        -------
        Scenario
            The changed scenario.

        Raises
        ------
        ScenarioError
            If a path is unknown or a value is not allowed.
        FeasibilityError
            If the rotors cannot lift the changed vehicle.
        """
        origin = self._origin or ScenarioSource(
            source=self.name,
            folder=self.folder,
            document=self.model_dump(mode="json"),
            is_resolved=True,
        )
        assignments = dict(origin.assignments)
        for text, value in values.items():
            path = parse_path(text)
            if path is None:
                raise ScenarioError(f"{origin.source}: {text[:60]!r} is not the path of a field.")
            assignments.pop(path, None)
            assignments[path] = value
        return self.from_origin(replace(origin, assignments=assignments))

    def replace(self, changes: Mapping[str, Any]) -> Self:
        """Return a validated copy of the scenario with some fields changed.

        Parameters
        ----------
        changes : mapping
            New values, nested as in a scenario file or by dotted path. In a table, fields that are
            not named keep their values. A list is replaced as a whole.

        Returns
        -------
        Scenario
            The changed scenario.

        Raises
        ------
        ScenarioError
            If a field is unknown or a value is not allowed.
        FeasibilityError
            If the rotors cannot lift the changed vehicle.

        Examples
        --------
        >>> from pyomo_quad import load_scenario
        >>> scenario = load_scenario("scenarios/paper_wind.toml")
        >>> slow = scenario.replace({"mission": {"duration": 12.0}, "vehicle.payload": 0.1})
        >>> slow.mission.duration, slow.vehicle.payload, scenario.mission.duration
        (12.0, 0.1, 10.0)
        """
        named = {".".join(map(str, steps)): value for steps, value in leaves(changes)}
        return self.with_values(named)

    def lasting(self, duration: float, passing_times: Sequence[float] = ()) -> Self:
        """Return the scenario with a fixed duration and, optionally, passing times of waypoints.

        The copy has no limits on the duration and no price of time, because both apply only to a
        free duration. The aim of least time becomes least energy. The values are not validated.

        Parameters
        ----------
        duration : float
            Duration of the flight [s], usually chosen by a plan.
        passing_times : sequence of float, optional
            Time at which each waypoint is passed [s].

        Returns
        -------
        Scenario
            Changed copy; the scenario itself if nothing changes.
        """
        if duration == self.mission.duration and not passing_times:
            return self
        values: dict[str, Any] = self.mission.chosen(float(duration))
        if passing_times:
            pairs = zip(self.mission.waypoints, passing_times, strict=True)
            values["waypoints"] = tuple(w.model_copy(update={"at": at}) for w, at in pairs)
        return self.with_mission(**values)

    def cruising(self, settings: CruiseSettings) -> Self:
        """Return a copy of the scenario with other settings of the baseline flight `cruise`.

        The flight `cruise` imitates the flight of an autopilot. A later call of `with_values` or
        `replace` on the copy undoes the change, because both start from the scenario file. Only a
        scenario made without a file, by `model_validate`, keeps the change.

        Parameters
        ----------
        settings : CruiseSettings
            Largest speed, acceleration and jerk of the flight `cruise`.
        """
        values = {
            "cruise_speeds": (settings.speed,),
            "cruise_acceleration": settings.acceleration,
            "cruise_jerk": settings.jerk,
        }
        return self.model_copy(update={"baseline": self.baseline.model_copy(update=values)})

    def with_mission(self, **values: Any) -> Self:  # noqa: ANN401
        """Return a copy of the scenario with fields of the table `mission` changed.

        Each keyword argument is the name of a field with its new value. The values are not
        validated.
        """
        mission = self.mission.model_copy(update=values)
        changed = self.model_copy(update={"mission": mission})
        if self._origin is not None:
            assignments = dict(self._origin.assignments)
            written = mission.model_dump(mode="json")
            assignments |= {("mission", name): written.get(name, values[name]) for name in values}
            changed._origin = replace(self._origin, assignments=assignments)  # noqa: SLF001
        return changed

    @property
    def nominal_duration(self) -> float:
        """Duration of the flight [s]; for a free duration, an estimate for the initial guess."""
        return self.nominal_times[-1]

    @property
    def nominal_times(self) -> tuple[float, ...]:
        """Prescribed or estimated times of the waypoints, and the end time of the flight [s].

        The tuple holds arrival and departure of each waypoint, then the end time. Each flight from
        one place to the next is estimated as twice its least possible time. These flight times are
        scaled to meet prescribed times and limits on the duration.
        """
        vehicle, limits = self.vehicle, self.limits
        lift = limits.thrust_max / vehicle.total_mass - self.gravity
        acceleration = min(max(lift, _LEAST_LIFT * self.gravity), self.gravity)
        spin = limits.yaw_moment_max / vehicle.Iz
        mission = self.mission
        ways = [dist(*leg) / acceleration for leg in pairwise(mission.positions)]
        # Include the time of a turn, and of a leg that returns to its start.
        ways[-1] = max(ways[-1], abs(mission.goal.yaw - mission.start.yaw) / spin)
        # The least time of a leg, with full acceleration over its first half and full deceleration
        # over its second half, is 2 sqrt(distance / acceleration).
        legs = [_UNHURRIED * 2 * sqrt(max(way, _SHORTEST_WAY)) for way in ways]
        if not mission.is_free:
            return mission.paced(legs)
        end = mission.paced(legs)[-1]
        least, greatest = mission.duration_limits
        if least <= end <= greatest:
            return mission.paced(legs)
        duration = min(max(end, least), greatest)
        return self.lasting(duration).mission.paced(legs)

    @property
    def keeps_yaw(self) -> bool:
        """Whether the plan keeps the heading constant throughout the flight.

        If the field `mission.yaw` is given, it decides. Otherwise the heading is constant if the
        power model is `momentum`, the field `vehicle.attitude` is ``euler``, and all prescribed
        headings are equal.
        """
        if self.mission.yaw is not None:
            return self.mission.yaw is Yaw.KEPT
        is_exact = self.vehicle.attitude is Attitude.EULER
        # In the power model `momentum` a turn costs almost no energy, so that many headings are
        # optimal. A constant heading makes the optimum unique, and is also usual for autopilots.
        is_undetermined = self.power.model is PowerModel.MOMENTUM and is_exact
        return is_undetermined and not self.mission.is_turning

    @property
    def mass_at_goal(self) -> float:
        """Mass of vehicle and remaining payload after all releases of payload at waypoints [kg]."""
        return self.vehicle.total_mass - self.mission.released

    def release_schedule(self) -> Callable[[float], float]:
        """Return a function of time [s] that gives the mass released so far at waypoints [kg].

        The payload of a waypoint is released when the flight leaves the waypoint. The times of
        departure are those of `nominal_times`, prescribed or estimated.
        """
        left = self.nominal_times[1:-1:2]
        dropped = [
            (t, waypoint.release)
            for t, waypoint in zip(left, self.mission.waypoints, strict=True)
            if waypoint.release > 0.0
        ]
        return lambda t: sum(release for left, release in dropped if left < t)

    def as_forecast(self) -> Self:
        """Return the scenario with the forecast in place of the actual wind.

        The planner uses this scenario if it must not know the actual wind. A later call of
        `with_values` or `replace` may undo the change, because both start from the scenario file.

        Returns
        -------
        Scenario
            Changed copy; the same object if the scenario has no forecast.
        """
        if self.wind.forecast is None:
            return self
        return self.model_copy(update={"wind": self.wind.forecast})

    def as_it_blows(self) -> Self:
        """Return a copy without the forecast, so that the planner uses the actual wind.

        A later call of `with_values` or `replace` on the copy may undo the change, because both
        start from the scenario file.
        """
        return self.model_copy(update={"wind": self.wind.model_copy(update={"forecast": None})})

    @property
    def contradictions(self) -> tuple[Contradiction, ...]:
        """Physical contradictions between the vehicle's numbers.

        If the equations come from a user's own Python function (field `model`), the result is
        empty, because the function may use other numbers than the scenario.
        """
        if self.model is not None:
            return ()
        return tuple(contradictions(self.vehicle, self.power, self.gravity))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on numbers of the vehicle that are physically possible but doubtful.

        If the equations come from a user's own Python function (field `model`), the result is
        empty, because the function may use other numbers than the scenario.
        """
        if self.model is not None:
            return ()
        return tuple(remarks(self.vehicle, self.power, self.gravity))

    def _check(self, source: str) -> None:
        """Raise an error if fields that are valid separately contradict each other.

        The error is a FeasibilityError if the only fault is that the rotors cannot lift the
        vehicle, and a ScenarioError otherwise. Its lines begin with `source`.
        """
        lines = [
            *self._power_complaints(),
            *self._airspace_complaints(),
            *self._replanning_complaints(),
            *self._payload_complaints(),
            *self._yaw_complaints(),
            *self._turbulence_complaints(),
            *self._validated_complaints(),
            *self._return_complaints(),
        ]
        unable = list(self._hover_complaints())
        if lines or unable:
            kind = ScenarioError if lines else FeasibilityError
            raise kind(listed([f"{source}: {line}" for line in (*unable, *lines)]))

    def _power_complaints(self) -> Iterator[str]:
        if self.model is not None:
            return  # the user's own model may need other numbers
        missing = [
            name for name in USED_BY[self.power.model] if getattr(self.vehicle, name) is None
        ]
        for name in missing:
            unit = unit_of(Vehicle, name)
            yield (
                f"vehicle.{name}, {_meaning(name)}, is missing; power.model "
                f"{self.power.model.value} needs it{f' in {unit}' if unit else ''}; give it, or "
                "choose another power.model."
            )
        if not missing:
            told = created_power(self.vehicle, self.power, self.gravity)
            yield from filter(None, [told])

    def _airspace_complaints(self) -> Iterator[str]:
        for field, place in self.mission.named_positions:
            told = self.as_forecast().wind
            for complaint_of_place in (*self.airspace.complaints(place), *told.complaints(place)):
                yield f"{field} = {shown(list(place))} m {complaint_of_place}."

    def _replanning_complaints(self) -> Iterator[str]:
        interval = None if self.baseline.mpc is None else self.baseline.mpc.interval
        field, longest = self.mission.longest
        if interval is not None and interval >= longest:
            yield (
                f"baseline.mpc.interval = {interval:g} s; must be below {field} = {longest:g} s, "
                "or nothing is planned again."
            )

    def _payload_complaints(self) -> Iterator[str]:
        released, carried = self.mission.released, self.vehicle.payload
        if released > carried:
            yield (
                f"mission.waypoints release {released:g} kg in all; must be at most "
                f"vehicle.payload = {carried:g} kg; release less or carry more."
            )

    def _yaw_complaints(self) -> Iterator[str]:
        if self.mission.yaw is Yaw.KEPT and self.vehicle.attitude is not Attitude.EULER:
            yield (
                'mission.yaw = "kept" under vehicle.attitude = '
                f'"{self.vehicle.attitude.value}"; must be "free" where rotors that gather speed '
                'do not turn the body: leave it out, or give vehicle.attitude = "euler".'
            )

    def _turbulence_complaints(self) -> Iterator[str]:
        if self.model is not None and self.wind.turbulence is not None:
            yield (
                f"wind.turbulence acts on the declared model only, model = {self.model!r}; leave "
                "one of them out."
            )

    def _return_complaints(self) -> Iterator[str]:
        if self.mission.return_reserve and self.wind.coupling is not WindCoupling.DRAG:
            yield (
                f'mission.return_reserve under wind.coupling = "{self.wind.coupling.value}"; must '
                f'be "{WindCoupling.DRAG.value}", for the return flies in moving air: set it, or '
                "leave return_reserve out."
            )

    def _validated_complaints(self) -> Iterator[str]:
        if not self.limits.within_validated:
            return
        most = self.vehicle.validated.payload
        if most is not None and self.vehicle.payload > most:
            yield (
                f"vehicle.payload = {self.vehicle.payload:g} kg; must be at most "
                f"vehicle.validated.payload = {most:g} kg under limits.within_validated; carry "
                "less, or leave limits.within_validated out."
            )
        if all(value is None for _, value in self.vehicle.validated):
            yield (
                "limits.within_validated needs vehicle.validated, which this vehicle does not "
                "state; give vehicle.validated.airspeed in m/s, or leave limits.within_validated "
                "out."
            )

    def _hover_complaints(self) -> Iterator[str]:
        if self.model is not None:
            return  # the user's own model need not hover
        share = 1 - self.limits.reserve
        left = f" less limits.reserve = {self.limits.reserve:g}" if share < 1 else ""
        needed = self.vehicle.hover_speed(self.gravity)
        weight = self.vehicle.total_mass * self.gravity
        if needed > share * self.limits.rotor_speed_max:
            yield (
                f"hover needs {needed:.4g} rad/s per rotor, limits.rotor_speed_max{left} "
                f"is {share * self.limits.rotor_speed_max:.4g} rad/s; raise the limit or lower the "
                "mass."
            )
        elif weight > share * self.limits.thrust_max:
            yield (
                f"hover needs {weight:.4g} N of thrust, limits.thrust_max{left} is "
                f"{share * self.limits.thrust_max:.4g} N; raise the limit or lower the mass."
            )


def _meaning(name: str) -> str:
    """Return the meaning of a vehicle's field in a few words, for error messages.

    For example, the description "momentum: radius of one rotor (R)" gives "radius of one rotor
    (R)".
    """
    meaning = (Vehicle.model_fields[name].description or name).rpartition(": ")[2]
    return meaning.partition(",")[0]


def _in_declared_units(
    origin: ScenarioSource, model: type[BaseModel]
) -> tuple[ScenarioSource, Rewritten]:
    """Convert values in other units, such as degrees, in tables and overrides to SI units.

    The class `model` of the scenario declares the fields and their units. The first result has the
    converted values. The second result records conversions and errors.
    """
    document = in_declared_units(origin.document, model)
    assignments, told = paths_in_declared_units(origin.assignments, model)
    both = Rewritten(
        tables={},
        spellings=document.spellings | told.spellings,
        complaints=[f"{origin.source}: {line}" for line in document.complaints]
        + [f"{origin.label}: {line}" for line in told.complaints],
        unread=[*document.unread, *told.unread],
    )
    return replace(origin, document=document.tables, assignments=assignments), both
