"""The report of a solve says what the plan says, in the same bytes each time."""

import re
from contextlib import nullcontext
from types import SimpleNamespace

import pandas as pd
import pytest

from pyomo_quad.flight import PlanStatus
from pyomo_quad.flight.orders import OrderSearch
from pyomo_quad.report import style
from pyomo_quad.report.document import drawn_meanwhile
from pyomo_quad.report.gallery import plan_drawings
from pyomo_quad.report.paths import distinct_paths
from pyomo_quad.report.render import environment
from pyomo_quad.report.report import write_solve_report
from pyomo_quad.report.style import plan_flight, styled_flights
from tests.declared_model import scenario
from tests.synthetic_run import synthetic_failure, synthetic_plan, synthetic_run

FIGURES = {
    "path", "states", "controls", "energy", "motors", "battery", "wind", "costates", "mesh",
}  # fmt: skip
DRAWN = {"path", "mesh"}  # the run's report draws all
HOSTILE = 'title="<script>*x*</script> [a](b)"'


@pytest.fixture(scope="module")
def run():
    return synthetic_run(overrides=(HOSTILE,))


@pytest.fixture(scope="module")
def report(run, tmp_path_factory):
    def save(draw, files):
        if files["svg"].stem in DRAWN:
            save_figure(draw, files)
        else:
            files["svg"].touch()

    folder, save_figure = tmp_path_factory.mktemp("report"), style.save_figure
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "save_figure", save)
        write_solve_report(folder, run.plan, ("the wind is strong",))
    return folder


@pytest.fixture
def _no_figures(monkeypatch):
    monkeypatch.setattr("pyomo_quad.report.document.drawn_meanwhile", lambda *_: nullcontext())


@pytest.mark.lengthy
def test_every_figure_is_drawn_and_linked(report):
    text = (report / "report.md").read_text()
    assert all(f"](figures/{name}.svg)" in text for name in FIGURES)
    assert {file.stem for file in (report / "figures").iterdir()} == FIGURES


def test_report_says_what_the_plan_says(report, run):
    text = (report / "report.md").read_text()
    assert "> **Verified in simulation.** The optimal flight" in text
    assert f"spends {run.plan.energy:.2f} J" in text
    assert "| Distance from the goal at the end (m) |  | 3e-07 | 0.0001 |" in text
    assert "- the wind is strong" in text
    assert "| 3 | 19 | 88 | 19 | 711.7000 | 3.1e-07 |" in text


@pytest.mark.usefixtures("_no_figures")
def test_the_order_that_was_found_is_told_with_its_gap(tmp_path, run):
    search = OrderSearch(order=(2, 0, 1), cost_J=1013.0, bound_J=1000.0, solved=7, legs=12)
    plan = SimpleNamespace(**vars(run.plan) | {"order_search": search})
    write_solve_report(tmp_path, plan, ())
    text = (tmp_path / "report.md").read_text()
    assert "2, 0, 1, counted from 0" in text
    assert "no other order is cheaper by more than 1.30 %. 7 of 12 legs were solved" in text


def test_title_is_escaped(report):
    first = (report / "report.md").read_text().splitlines()[0]
    assert first == r"# &lt;script&gt;\*x\*&lt;/script&gt; \[a\](b)"


def test_plan_table_reads_back(report, run):
    read = pd.read_csv(report / "plan.csv")
    pd.testing.assert_frame_equal(read, run.plan.to_frame(), rtol=1e-11, check_dtype=False)


@pytest.mark.usefixtures("_no_figures")
@pytest.mark.parametrize(
    ("status", "heading"),
    [
        (PlanStatus.INFEASIBLE, "# Failed, infeasible: "),
        (PlanStatus.NOT_CONVERGED, "# Failed, not converged: "),
        (PlanStatus.INTERRUPTED, "# Failed, interrupted: "),
        (PlanStatus.SOLVED, "# Not verified: "),
    ],
)
def test_failure_is_never_called_a_success(run, tmp_path, status, heading):
    flight = run.flights[0]
    plan = synthetic_plan(run.scenario, flight, status, "Point of local infeasibility | see below")
    write_solve_report(tmp_path, plan)
    text = (tmp_path / "report.md").read_text()
    assert text.startswith(heading)
    assert "## What went wrong\n\nPoint of local infeasibility \\| see below" in text
    assert "Verified in" not in text
    if status is not PlanStatus.SOLVED:
        assert "optimal" not in text
        assert set(pd.read_csv(tmp_path / "plan.csv")["status"]) == {status.value}


@pytest.mark.usefixtures("_no_figures")
def test_failure_names_cause_equation_and_limit(run, tmp_path):
    status, failure = PlanStatus.INFEASIBLE, synthetic_failure()
    write_solve_report(
        tmp_path, synthetic_plan(run.scenario, run.flights[0], status, "no way", failure)
    )
    text = (tmp_path / "report.md").read_text()
    cause = "mission.duration = 2 s is 1.4 s too short: within rotors.omega"
    assert f"> **Failed, infeasible.** No flight was found: {cause}" in text
    assert "| `rigid_body.z_balance` | 5 | 0.8819 | 3.6 | `N` |" in text
    assert "| speed of rotor | 1047.2 | rad/s | 62 |" in text


@pytest.mark.usefixtures("_no_figures")
def test_tables_and_text_are_the_same_bytes_each_time(report, run, tmp_path):
    write_solve_report(tmp_path, run.plan, ("the wind is strong",))
    for name in ("plan.csv", "report.md"):
        assert (tmp_path / name).read_bytes() == (report / name).read_bytes()


@pytest.mark.lengthy
def test_figures_are_the_same_bytes_each_time_and_hold_no_date(report, run, tmp_path):
    flights = styled_flights([plan_flight(run.plan)])
    drawings = [d for d in plan_drawings(run.plan, flights) if d.name in DRAWN]
    with drawn_meanwhile(drawings, tmp_path):
        pass
    files = list((tmp_path / "figures").iterdir())
    assert len(files) == len(DRAWN)
    for file in files:
        assert file.read_bytes() == (report / "figures" / file.name).read_bytes()
        assert not re.search(rb"dc:date|20\d\d-\d\d-\d\d", file.read_bytes())


def test_figures_of_what_a_model_lacks_are_left_out(run):
    flight = plan_flight(run.plan)
    flight.frame = flight.frame.drop(columns="wind_x_m_per_s").assign(
        battery_current_A=float("nan")
    )
    names = {d.name for d in plan_drawings(run.plan, styled_flights([flight]))}
    assert names == FIGURES - {"wind", "battery"}


def test_paths_too_near_to_the_optimum_are_named_and_not_drawn():
    run = synthetic_run(flights=("optimal", "adaptive/quintic", "open_loop/plan"))
    flights = styled_flights(run.flights)
    assert [flight.name for flight in distinct_paths(flights)] == ["optimal", "adaptive/quintic"]
    path = plan_drawings(run.plan, flights)[0]
    assert path.caption.endswith("because they follow the path of optimal: open_loop/plan.")


def test_a_wind_is_told_with_its_profile_and_its_updraft():
    wind = {"use": "constant", "vertical": 0.5, "profile": {"law": "power", "exponent": 0.2}}
    sections = environment().get_template("report/sections.md.j2").make_module({"plan": None})
    told = str(sections.air(scenario(wind=wind).wind))
    assert told.endswith(", with 0.5 m/s upwards; by height under the power law, as given at 10 m")
    assert "height" not in str(sections.air(scenario().wind))
