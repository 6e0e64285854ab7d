"""Vehicle and battery files (TOML) of an estimated vehicle, with the source of every number.

The numbers of an estimated vehicle follow from the few data that its owner knows.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from pyomo_quad.report.folder import MARK
from pyomo_quad.scenario import Scenario, scenario_from_mapping
from pyomo_quad.scenario.toml_text import with_source
from pyomo_quad.vehicles.estimate import Estimate
from pyomo_quad.vehicles.owner import EstimatedVehicle

_DIGITS = 6


def pack_name(name: str) -> str:
    """Return the name of a vehicle's battery file, ``{name}_pack.toml``."""
    return f"{name}_pack.toml"


def vehicle_text(vehicle: EstimatedVehicle, title: str) -> str:
    """Return the text of an estimated vehicle's file (TOML), each number with its source.

    `title` is a short description of the vehicle.
    """
    known = vehicle.known
    lines = [
        f"# {MARK}: {title}.",
        '# Under power.model = "momentum"; derivations: docs/theory/vehicle_from_data.md.',
        f'battery = "{pack_name(known.name)}"',
        *with_source("fields.title", title, "the owner"),
        *_numbers("fields", vehicle.fields),
    ]
    if vehicle.rotor_positions is not None:
        held = [list(place) for place in vehicle.rotor_positions]
        lines += with_source("fields.rotor_positions", held, "a ring on the arms")
    return "\n".join([*lines, *_numbers("limits", vehicle.limits)]) + "\n"


def pack_text(vehicle: EstimatedVehicle) -> str:
    """Return the text of an estimated vehicle's battery file (TOML), with the numbers' sources."""
    title = f"Pack of {vehicle.known.name}, {vehicle.pack.label}"
    lines = [f"# {MARK}.", *with_source("fields.title", title, "the owner")]
    return "\n".join([*lines, *_numbers("fields", vehicle.pack.fields())]) + "\n"


def _numbers(section: str, numbers: Mapping[str, Estimate]) -> Iterator[str]:
    for name, one in numbers.items():
        whole = name.startswith("cells_")
        value = int(one.value) if whole else float(f"{one.value:.{_DIGITS}g}")
        yield from with_source(f"{section}.{name}", value, one.source)


def scenario_of(vehicle: EstimatedVehicle) -> Scenario:
    """Make a scenario in which an estimated vehicle flies 40 m in calm air.

    The power model is `momentum`, whose parameters are among the estimated numbers of the vehicle.
    """
    tables: dict[str, Any] = {
        "name": vehicle.known.name,
        "wind": {"use": "calm", "coupling": "drag"},
        "power": {"model": "momentum"},
        "mission": {"goal": {"position": [40.0, 0.0, 0.0]}, "duration": 10.0},
    }
    tables["vehicle"] = {name: one.value for name, one in vehicle.fields.items()}
    tables["limits"] = {name: one.value for name, one in vehicle.limits.items()}
    tables["battery"] = {
        name: int(one.value) if name.startswith("cells_") else one.value
        for name, one in vehicle.pack.fields().items()
    }
    if vehicle.rotor_positions is not None:
        tables["vehicle"]["rotor_positions"] = [list(place) for place in vehicle.rotor_positions]
    return scenario_from_mapping(tables, source=vehicle.known.name)


def example_mission(name: str) -> str:
    """Return the text of an example scenario (TOML): the named vehicle flies 40 m in calm air."""
    return (
        f'name = "{name}_hop"\n'
        f'vehicle = {{ use = "{name}.toml" }}\n'
        'power = { model = "momentum" }\n'
        "mission = { start = { position = [0, 0, 10] }, goal = { position = [40, 0, 10] }, "
        "duration = 10 }\n"
    )
