"""The declared equations of the paper in LaTeX, and where each numbered one is declared."""

from collections.abc import Iterator

from pyomo_quad.model import build_model
from pyomo_quad.model.typeset import EQUATION_TABLE, TypesetEquation, typeset_equations
from pyomo_quad.report.document import Code, Piece, Table
from pyomo_quad.report.markdown import escape_markdown
from pyomo_quad.report.wording import POWER_WORDS
from pyomo_quad.scenario import PowerModel, WindCoupling
from pyomo_quad.study.paper.missions import Experiment, paper_scenario

__all__ = ["equation_table", "equations_markdown"]

_OTHER_POWERS = tuple(model for model in PowerModel if model is not PowerModel.MOTOR)


def equation_table() -> Table:
    """Return the table from the paper's equation numbers to the functions that declare them.

    Returns
    -------
    Table
        One row for each equation.
    """
    rows: list[list[Piece]] = [
        [f"({number})", Code(function)]
        for number, functions in EQUATION_TABLE.items()
        for function in functions
    ]
    return Table(
        caption="Where each equation of the paper is declared",
        header=("equation", "declared by"),
        rows=rows,
    )


def equations_markdown() -> str:
    """Return the declared equations, each written by the program from its Pyomo declaration.

    Returns
    -------
    str
        Markdown with formulas between double dollar signs.
    """
    parts = [
        "## Declared equations",
        (
            "Every formula below is written by the program from the Pyomo declaration that "
            "optimiser and simulator read; a text beside a formula is that declaration's own."
        ),
    ]
    seen: set[str] = set()
    for title, equations in _groups():
        fresh = [equation for equation in equations if equation.latex not in seen]
        seen.update(equation.latex for equation in fresh)
        parts.append(f"### {escape_markdown(title)}")
        parts += [_equation(equation) for equation in fresh]
    return "\n\n".join(parts) + "\n"


def _groups() -> Iterator[tuple[str, tuple[TypesetEquation, ...]]]:
    yield (
        "The second experiment, under the electrical power of the motors",
        typeset_equations(build_model(paper_scenario(Experiment.WIND))),
    )
    for power in _OTHER_POWERS:
        scenario = paper_scenario(Experiment.WIND, {"power.model": power})
        equations = typeset_equations(build_model(scenario))
        of_power = tuple(equation for equation in equations if equation.name.startswith("power."))
        yield f"Power: {POWER_WORDS[power]}", of_power
    drag = paper_scenario(Experiment.WIND, {"wind.coupling": WindCoupling.DRAG})
    yield "Wind through drag on the relative airspeed", typeset_equations(build_model(drag))


def _equation(equation: TypesetEquation) -> str:
    description = escape_markdown(equation.description or equation.name)
    return f"{description} (`{equation.name}`)\n\n$$\n{equation.latex}\n$$"
