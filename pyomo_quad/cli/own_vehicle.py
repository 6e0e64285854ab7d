"""Commands `vehicle` and `vehicles`.

The command `vehicle` writes a vehicle file from its owner's data. The command `vehicles` compares
power that the models compute with measured power, for library vehicles and for data sheets.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pyomo_quad.cli.endings import ExitCode, raise_on_interrupt
from pyomo_quad.cli.looking import write_new
from pyomo_quad.cli.terminal import FigureChoice, Quiet, ReportFolder, complain, option, real_number
from pyomo_quad.report import Figures
from pyomo_quad.report.folder import output_folder, refuse_output_folder
from pyomo_quad.scenario import ScenarioError

if TYPE_CHECKING:
    from pyomo_quad.vehicles.owner import EstimatedVehicle, Known
    from pyomo_quad.vehicles.uncertainty import PowerBand


_Number = float | None
Mass = Annotated[_Number, option("--mass", "KG", "Mass in flight, battery included.", real_number)]
Propeller = Annotated[
    str | None, option("--propeller", "DxP", "Diameter and pitch in inches, such as 10x4.5.")
]
Arm = Annotated[
    _Number, option("--arm", "M", "Distance from the centre to a motor shaft.", real_number)
]
Kv = Annotated[_Number, option("--kv", "RPM/V", "Motor speed per volt.", real_number)]
Pack = Annotated[
    str | None, option("--battery", "LABEL", "Cells in series and mAh, such as 4S5000.")
]
HoverCurrent = Annotated[
    _Number, option("--hover-current", "A", "Current from the pack in hover.", real_number)
]
HoverVoltage = Annotated[
    _Number,
    option(
        "--hover-voltage", "V", "Voltage of the pack in hover; by default nominal.", real_number
    ),
]
Rotors = Annotated[int, option("--rotors", "N", "Number of rotors: 4, 6 or 8.")]


def vehicle(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name of the vehicle and of its files.")
    ],
    *,
    mass: Mass = None,
    propeller: Propeller = None,
    arm: Arm = None,
    kv: Kv = None,
    battery: Pack = None,
    hover_current: HoverCurrent = None,
    hover_voltage: HoverVoltage = None,
    rotors: Rotors = 4,
    out: Annotated[Path, option("--out", "DIR", "Folder for the files.")] = Path(),
    quiet: Quiet = False,
) -> int:
    """Estimate a vehicle and its battery from their owner's data, and write them as files.

    Each number is written with its source. Only mass and propeller are required; on a terminal the
    command asks for missing data.
    """
    from pyomo_quad.vehicles.files import (  # noqa: PLC0415  takes a second
        pack_name,
        pack_text,
        vehicle_text,
    )
    from pyomo_quad.vehicles.owner import estimate_vehicle  # noqa: PLC0415
    from pyomo_quad.vehicles.uncertainty import power_band  # noqa: PLC0415

    if is_asked(is_quiet=quiet):
        mass = _asked(mass, "mass aloft, kg", is_needed=True)
        propeller = propeller or typer.prompt("propeller, inches, such as 10x4.5")
        arm = _asked(arm, "centre to motor shaft, m")
        kv = _asked(kv, "kv of the motors, rpm/V")
        battery = battery or typer.prompt("battery, such as 4S5000", default="") or None
        hover_current = _asked(hover_current, "current in hover, A")
        if hover_current is not None:
            hover_voltage = _asked(hover_voltage, "voltage in hover, V")
    known = _known(name, mass, propeller, arm, kv, battery, rotors)
    known = _with_hover(known, hover_current, hover_voltage)
    estimated = estimate_vehicle(known)
    texts = {
        f"{name}.toml": vehicle_text(estimated, _title(known)),
        pack_name(name): pack_text(estimated),
    }
    write_new({out / file: text for file, text in texts.items()})
    if not quiet:
        with raise_on_interrupt():
            band = power_band(estimated)
        for line in _lines(estimated, band, out):
            print(line)
    return ExitCode.VERIFIED


def is_asked(*, is_quiet: bool) -> bool:
    """Return whether the command may ask the user for missing data on a terminal.

    It may if the option `--quiet` is not given, and if standard input and standard output are a
    terminal.
    """
    return not is_quiet and sys.stdin is not None and sys.stdin.isatty() and sys.stdout.isatty()


def _asked(given: float | None, words: str, *, is_needed: bool = False) -> float | None:
    """Return the value of an option; if it is None, ask the user the question `words`.

    An empty answer gives None. If `is_needed` is True, the question is repeated instead.
    """
    while given is None:
        answer = typer.prompt(words, default="" if not is_needed else None, show_default=False)
        if not answer.strip() and not is_needed:
            return None
        try:
            given = real_number(answer)
        except typer.BadParameter as error:
            complain(str(error))
    return given


def _known(
    name: str,
    mass: float | None,
    propeller: str | None,
    arm: float | None,
    kv: float | None,
    battery: str | None,
    rotors: int,
) -> "Known":
    from pyomo_quad.scenario.description import refuse_no_name  # noqa: PLC0415
    from pyomo_quad.scenario.vehicle import RPM  # noqa: PLC0415
    from pyomo_quad.vehicles.owner import Known  # noqa: PLC0415
    from pyomo_quad.vehicles.pack import pack_of  # noqa: PLC0415
    from pyomo_quad.vehicles.propulsion import propeller_of  # noqa: PLC0415

    refuse_no_name(name)
    if mass is None or propeller is None:
        raise ScenarioError(
            "vehicle: needs --mass in kg and --propeller in inches at least, such as --mass 1.5 "
            "--propeller 10x4.5."
        )
    for flag, value, unit in (("--mass", mass, "kg"), ("--arm", arm, "m"), ("--kv", kv, "rpm/V")):
        if value is not None and not 0 < value < float("inf"):
            raise ScenarioError(f"{flag} {value:g} {unit}; must be > 0.")
    return Known(
        name=name,
        mass=mass,
        propeller=propeller_of(propeller),
        arm=arm,
        voltage_constant=None if kv is None else kv * RPM,
        pack=None if battery is None else pack_of(battery),
        rotors=rotors,
    )


def _with_hover(known: "Known", current: float | None, voltage: float | None) -> "Known":
    from dataclasses import replace  # noqa: PLC0415

    if current is None:
        if voltage is not None:
            raise ScenarioError(
                "--hover-voltage: is given without a current; give --hover-current in A too."
            )
        return known
    if voltage is None and known.pack is None:
        raise ScenarioError(
            "--hover-current: is given without a voltage; give --hover-voltage in V or --battery."
        )
    nominal = known.pack.nominal_voltage if known.pack is not None else 0.0
    at = nominal if voltage is None else voltage
    if not (0 < current < float("inf") and 0 < at < float("inf")):
        raise ScenarioError(f"hover: {current:g} A at {at:g} V; both must be > 0.")
    said = f"{current:g} A at {at:g} V"
    return replace(known, hover_power=current * at, hover_said=said)


def _title(known: "Known") -> str:
    inches = known.propeller.diameter / 0.0254, known.propeller.pitch / 0.0254
    size = f"{inches[0]:.3g}x{inches[1]:.3g}"
    return f"{known.name}, {known.mass:g} kg on {known.rotors} propellers {size}"


def _lines(estimated: "EstimatedVehicle", band: "PowerBand", out: Path) -> list[str]:
    from pyomo_quad.polar.polar import find_polar  # noqa: PLC0415  takes a second
    from pyomo_quad.vehicles.files import example_mission, pack_name, scenario_of  # noqa: PLC0415
    from pyomo_quad.vehicles.uncertainty import AIRSPEEDS  # noqa: PLC0415

    known = estimated.known
    own = find_polar(scenario_of(estimated)).own
    best = own.best_over_ground()
    lines = [
        f"{_title(known)}, pack {estimated.pack.label}.",
        "airspeed m/s:  " + "".join(f"{speed:9g}" for speed in AIRSPEEDS),
        "power W:       " + "".join(f"{one:9.0f}" for one in band.power),
        "from:          " + "".join(f"{one:9.0f}" for one in band.low),
        "to:            " + "".join(f"{one:9.0f}" for one in band.high),
    ]
    lines.append(
        f"Hover {band.power[0]:.0f} W ({band.low[0]:.0f} to {band.high[0]:.0f}), "
        f"{float(own.endurances[0]) / 60:.1f} min; least energy per metre "
        f"{best.energy_per_metre:.1f} J/m at {best.ground_speed:.1f} m/s, "
        f"{best.range_m / 1000:.1f} km."
    )
    if estimated.is_measured:
        lines.append(
            f"Measured power of hover: {known.hover_power:.0f} W; the estimates without this "
            f"measurement give {estimated.estimated_hover_W:.0f} W."
        )
    ranked = band.ranked()
    told = [f"{cause.name} ({100 * share:.0f} % of the power)" for cause, share in ranked[:3]]
    lines.append(f"Least certain: {'; '.join(told)}.")
    lines.append(f"The measurement that helps most: {ranked[0][0].measurement}.")
    lines.append(f"Written to {out / f'{known.name}.toml'} and {out / pack_name(known.name)}.")
    lines.append("A scenario beside them that flies 40 m:")
    return lines + ["  " + line for line in example_mission(known.name).splitlines()]


_VEHICLES_FOLDER = Path("reports") / "vehicles"


def vehicles(
    *,
    out: ReportFolder = _VEHICLES_FOLDER,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
) -> int:
    """Compare computed with measured power, for library vehicles and for six data sheets.

    The data sheets show how well the command `vehicle` estimates a vehicle from its owner's data.
    The report has one page for each library vehicle.
    """
    refuse_output_folder(out)
    from pyomo_quad.flight import Planner  # noqa: PLC0415  takes a second
    from pyomo_quad.vehicles.holding import held_vehicles  # noqa: PLC0415
    from pyomo_quad.vehicles.report import write_vehicles  # noqa: PLC0415

    planner = Planner()
    with raise_on_interrupt(), output_folder(out) as aside:
        held = held_vehicles(planner)
        sheets = write_vehicles(aside, held, planner, figures)
    if not quiet:
        for row in sheets.itertuples():
            print(f"{row.vehicle}: {row.estimated_W:.4g} W, measured {row.measured_W:.4g} W")
        for one in held:
            print(f"{one.name}: {one.mean_error:.1f} % over {len(one.points)} points")
        print(f"Written to {out}.")
    return ExitCode.VERIFIED
