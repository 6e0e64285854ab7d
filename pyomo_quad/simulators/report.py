"""The report of the outside plant: a table of flights, and what makes them differ."""

from importlib.metadata import version
from pathlib import Path

from pyomo_quad.flight.outside_plant import PLANT
from pyomo_quad.report.render import render_markdown, rough
from pyomo_quad.report.report import REPORT_NAME
from pyomo_quad.report.tables import write_table
from pyomo_quad.simulators.study import BREEZE, CASES, EXACT, PRINTED, Column, OutsideStudy, Plant
from pyomo_quad.simulators.vehicles import NAMES
from pyomo_quad.version import __version__

TABLE_NAME = "flights.csv"


def write_outside_report(folder: Path, study: OutsideStudy) -> None:
    """Write the table and `report.md` into an existing folder."""
    write_table(study.flights, folder / TABLE_NAME)
    apart = {case: study.apart(case, Plant.ROTORPY) for case in (PRINTED, EXACT, BREEZE)}
    apart["bare"] = study.apart(EXACT, Plant.WITHOUT_ROTOR_INERTIA)
    apart |= {name: study.apart(name, Plant.WITHOUT_ROTOR_INERTIA) for name in NAMES}
    text = render_markdown(
        "simulators/outside_plant.md.j2",
        apart={cause: rough(distance) for cause, distance in apart.items()},
        rows=study.flights.to_dict("records"),
        column=Column,
        cases=CASES,
        sets=NAMES,
        TABLE_NAME=TABLE_NAME,
        version=__version__,
        version_of_rotorpy=version(PLANT),
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")
