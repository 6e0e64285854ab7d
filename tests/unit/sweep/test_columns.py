"""Every output column of a sweep declares its unit; printed units follow from the declaration."""

import pytest

from pyomo_quad.scenario.tables import Reference
from pyomo_quad.sweep.case import StudyTask, output_columns, unit_of_column
from pyomo_quad.sweep.quantities import output_quantity

NAMES = sorted({name for task in StudyTask for name in output_columns(task, tuple(Reference))})
DIMENSIONLESS = {"max_violation", "error_estimate"}


@pytest.mark.parametrize("name", NAMES)
def test_a_column_is_named_after_its_declared_unit(name):
    unit = unit_of_column(name)
    assert (unit == "") is (name in DIMENSIONLESS)
    assert name.endswith(f"_{unit}" if unit else name)
    printed = output_quantity(name)
    assert printed.unit == {"rad": "°", "percent": "%"}.get(unit, unit)
    assert not printed.name.endswith(f" {unit}") or not unit


def test_no_unit_is_guessed_from_the_name_of_an_unknown_column():
    assert output_quantity("number_of_m").unit == ""
