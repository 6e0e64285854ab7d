"""The report of a run answers first, and its tables say what the comparison says."""

import re
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from pyomo_quad.flight import PlanStatus
from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.flight.columns import TIME
from pyomo_quad.flight.flight import Resolve
from pyomo_quad.report import Figures
from pyomo_quad.report.document import drawn_meanwhile
from pyomo_quad.report.gallery import adaptation_drawing, plan_drawings
from pyomo_quad.report.page import render_html
from pyomo_quad.report.paths import leaving_paths
from pyomo_quad.report.report import write_compare_report, write_run_report
from pyomo_quad.report.style import flight_styles, styled_flights
from pyomo_quad.scenario.tables import MISSION_TIMED
from pyomo_quad.study.comparison import (
    ERROR_WITH,
    ERROR_WITHOUT,
    ESTIMATED,
    TRUE,
    combine,
    compare_flights,
)
from tests.synthetic_run import HOVER_ENERGY_J, synthetic_plan, synthetic_run

FIGURES = {
    "map", "power_over_time", "energy_split",
    "path", "states", "controls", "energy", "motors", "battery", "wind", "costates", "mesh",
}  # fmt: skip
ANSWER = (
    "> **Verified in simulation.** The plan takes 711.70 J (0.31 % of the battery) and 10 s: 1.67 "
    "% less energy than a controller without the plan (adaptive/quintic: 723.80 J, 10 s). Flights "
    "in gusts were not simulated."
)


def write(folder, run):
    write_run_report(folder, run)
    return (folder / "report.md").read_text()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    write_run_report(folder, synthetic_run(), Figures.ALL)
    return folder


@pytest.fixture
def _no_figures(monkeypatch):
    # Drawing is tested once above; here only the text counts.
    monkeypatch.setattr("pyomo_quad.report.document.drawn_meanwhile", lambda *_: nullcontext())
    monkeypatch.setattr("pyomo_quad.report.report.write_page", lambda *_, **__: None)


@pytest.mark.lengthy
def test_answer_comes_first(report):
    answer, _, margins = (report / "report.md").read_text().split("\n\n")[1].splitlines()
    assert answer == ANSWER
    assert margins.startswith("> No margins: ")


@pytest.mark.lengthy
def test_both_reports_hold_the_same_headings_and_numbers(report):
    text, page = (report / "report.md").read_text(), (report / "report.html").read_text()
    headings = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert re.findall(r"<h2[^>]*>(.*?)</h2>", page) == headings
    cells = re.findall(r'<td class="number">(.*?)</td>', page)
    assert all(f"| {cell} " in text for cell in cells)


@pytest.mark.lengthy
def test_every_number_travels_with_the_hover_floor(report):
    text = (report / "report.md").read_text()
    row = "10.00 | 723.80 | 0.00 | 709.60 | 14.20 | 1.67 | 85.21 | 708.40 | 2.13 |"
    assert f"| `adaptive/quintic` | {row}" in text
    assert "| `adaptive/step` | 10.00 | 780.60 | n/a | 709.60 | 71.00 | n/a | n/a |" in text
    assert "| `adaptive/step` | no |" in text


@pytest.mark.lengthy
def test_every_figure_is_drawn_in_both_formats_and_linked(report):
    text = (report / "report.md").read_text()
    for name in FIGURES:
        with Image.open(report / "figures" / f"{name}.png") as picture:
            assert picture.width > 1000
        assert "<svg" in (report / "figures" / f"{name}.svg").read_text()[:1000]
        assert f"](figures/{name}.svg)" in text
        assert f"([PNG](figures/{name}.png))" in text
    assert {file.stem for file in (report / "figures").iterdir()} == FIGURES


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["report.md", "report.html", "comparison.md"])
def test_stand_in_is_called_one(report, name):
    assert "It stands in for the controller that the paper cites" in (report / name).read_text()


@pytest.mark.lengthy
def test_comparison_reads_back(report):
    read = pd.read_csv(report / "comparison.csv")
    expected = synthetic_run().comparison
    pd.testing.assert_frame_equal(read, expected, check_dtype=False, rtol=1e-11)


@pytest.mark.lengthy
def test_page_fits_in_a_mail(report):
    assert (report / "report.html").stat().st_size < 3e6


@pytest.mark.usefixtures("_no_figures")
def test_no_certificate_is_said(tmp_path):
    run = synthetic_run(overrides=('power.model="efficiency"',))
    run.certificate.lower_bound_J = None
    run.certificate.gap_percent = lambda energy_J: None
    run.certificate.reason = "power.model efficiency is not convex."
    text = write(tmp_path, run)
    assert "**No bound is known for this mission:** power.model efficiency is not convex." in text
    assert "No flight of this mission" not in text


@pytest.mark.usefixtures("_no_figures")
@pytest.mark.parametrize("waypoints", ["[]", "[{position = [1.0, 2.0, 3.0], at = 5.0}]"])
def test_a_bound_over_passing_times_is_explained_to_pilots(tmp_path, waypoints):
    text = write(tmp_path, synthetic_run(overrides=(f"mission.waypoints={waypoints}",)))
    explained = "The bound is the least over all these choices"
    assert (explained in text) == (waypoints != "[]")


@pytest.mark.usefixtures("_no_figures")
def test_a_bound_over_ways_of_flying_is_explained_to_pilots(tmp_path):
    of = ('vehicle.use="dji_matrice_100"', 'power.model="momentum"')
    text = write(tmp_path, synthetic_run(overrides=of))
    assert "the mixture may circle instead of hovering, which costs less." in text


@pytest.mark.usefixtures("_no_figures")
def test_cheapest_rival_is_named_when_the_fair_one_did_not_arrive(tmp_path):
    run = synthetic_run(flights=("optimal", "adaptive/minimum_snap", "adaptive/step"))
    assert "(adaptive/minimum\\_snap: 729.30 J, 10 s)" in write(tmp_path, run)


@pytest.mark.usefixtures("_no_figures")
def test_without_a_rival_the_optimum_stands_alone(tmp_path):
    run = synthetic_run(flights=("optimal", "adaptive/step"))
    text = write(tmp_path, run)
    assert "> **Verified in simulation.** The plan takes 711.70 J" in text
    assert "and 10 s: no other flight arrived within its limits to compare with." in text


@pytest.mark.usefixtures("_no_figures")
def test_a_plan_that_ends_far_from_its_goal_is_not_compared(tmp_path):
    run = synthetic_run()
    run.comparison.loc[run.comparison["flight"] == "optimal", "arrived"] = False
    text = write(tmp_path, run)
    assert "it ends too far from the goal, or breaks a limit, for a comparison" in text
    assert "no other flight arrived" not in text


@pytest.mark.usefixtures("_no_figures")
def test_failed_run_is_never_called_a_success(tmp_path):
    run = synthetic_run()
    run.plan = synthetic_plan(run.scenario, run.flights[0], PlanStatus.INFEASIBLE, "no way")
    run.flights, run.comparison = (), run.comparison.iloc[:0]
    text = write(tmp_path, run)
    assert text.startswith("# Failed, infeasible: ")
    assert "Verified in" not in text
    assert "saving" not in text.lower()
    assert "costates" not in text.lower()
    assert not list(tmp_path.glob("comparison.*"))
    assert "comparison" not in text


def test_adaptation_adds_its_figure(tmp_path):
    time = np.linspace(0.0, 10.0, 50)
    study = pd.DataFrame({TIME: time, ERROR_WITH: np.exp(-time), ERROR_WITHOUT: 0.3 + 0 * time})
    study = study.assign(**dict.fromkeys((*TRUE, *ESTIMATED), 1.0))
    with drawn_meanwhile([adaptation_drawing(study)], tmp_path):
        pass
    assert [file.name for file in (tmp_path / "figures").iterdir()] == ["adaptation.svg"]


@pytest.mark.usefixtures("_no_figures")
def test_comparison_of_many_scenarios_names_them(tmp_path):
    calm = synthetic_run("scenarios/paper_calm.toml").comparison
    compared = combine([calm, synthetic_run().comparison])
    write_compare_report(tmp_path, compared, is_good=True, figures=Figures.NONE)
    text = (tmp_path / "comparison.md").read_text()
    assert "| Scenario | Flight | Duration (s) | Energy (J) |" in text
    assert "| `paper_calm` | `optimal` | 10.00 | 711.70 |" in text
    assert "| `paper_wind` | `optimal` | 10.00 | 711.70 |" in text


def test_flight_that_goes_astray_does_not_hide_the_others():
    run = synthetic_run(flights=("optimal", "adaptive/quintic", "open_loop/plan"))
    lost = run.flights[2]
    lost.frame = lost.frame.assign(x_m=10 * lost.frame["x_m"])
    flights = styled_flights(run.flights)
    assert [flight.name for flight in leaving_paths(flights)] == ["open_loop/plan"]
    path = plan_drawings(run.plan, flights)[0]
    assert path.caption.endswith("Extends beyond the figure: open_loop/plan.")
    above = path.draw().axes[1]
    assert above.get_xlim()[1] < 12


def test_a_flight_keeps_its_colour_whatever_is_drawn_beside_it():
    run = synthetic_run()
    alone = {flight.name: styled_flights([flight])[0].style for flight in run.flights}
    for flights in (run.flights, run.flights[::-1], run.flights[1:3]):
        for flight in styled_flights(flights):
            assert flight.style == alone[flight.name]
    names = ("optimal", *map(baseline_name, MISSION_TIMED), OPEN_LOOP)
    styles = flight_styles((*names, "a pack"))
    assert len({style.color for style in styles.values()}) == len(names) + 1


def test_calm_air_has_no_wind_figure():
    for path, is_windy in (
        ("scenarios/paper_calm.toml", False),
        ("scenarios/paper_wind.toml", True),
    ):
        run = synthetic_run(path)
        names = {drawing.name for drawing in plan_drawings(run.plan, styled_flights(run.flights))}
        assert ("wind" in names) == is_windy


def test_captions_name_what_their_figures_hide():
    run = synthetic_run()
    quintic = run.flights[1]
    power = quintic.frame["power_W"].to_numpy().copy()
    power[200] = 400.0
    quintic.frame = quintic.frame.assign(power_W=power)
    flights = styled_flights(run.flights)
    captions = {drawing.name: drawing.caption for drawing in plan_drawings(run.plan, flights)}
    left = "adaptive/minimum_snap, adaptive/step and open_loop/plan."
    assert captions["states"].endswith(f"Not drawn: {left}")
    assert captions["controls"].endswith(f"Not drawn: adaptive/quintic, {left}")
    assert "adaptive/quintic (" in captions["energy"]
    assert "to 400.0 W" in captions["energy"]
    assert captions["energy"].endswith("The curve of optimal covers that of open_loop/plan.")


UNTOLD = (
    "> **Verified in simulation, in the forecast wind only.** The plan was made for the forecast "
    "wind, in which it spends 711.70 J. In the actual wind `open_loop/plan`, without feedback, "
    "misses the goal by 67 m; `adaptive/plan`, under feedback, arrives 0.0084 m from the goal and "
    "spends {spent:.2f} J. Following it {outcome} over `adaptive/quintic` "
    "(723.80 J), which needs no plan."
)


@pytest.mark.usefixtures("_no_figures")
@pytest.mark.parametrize(
    ("above_quintic_J", "outcome"), [(0.06, "gains nothing"), (-7.238, "saves 1.00 %")]
)
def test_headline_of_an_untold_wind_names_the_miss_and_what_the_plan_is_worth(
    tmp_path, above_quintic_J, outcome
):
    run = synthetic_run("scenarios/wind_untold.toml")
    lost, quintic = run.flights[-1], run.flights[1]
    lost.terminal_miss_m, lost.terminal_miss = 67.0, {"rigid_body.x": 67.0}
    spent = quintic.energy_J + above_quintic_J
    followed = SimpleNamespace(
        **(vars(quintic) | {"name": "adaptive/plan", "energy_J": spent, "terminal_miss_m": 0.0084})
    )
    run.flights = (*run.flights, followed)
    run.comparison = compare_flights(run.scenario, run.flights, run.certificate, HOVER_ENERGY_J)
    text = write(tmp_path, run)
    assert text.split("\n\n")[1] == UNTOLD.format(spent=spent, outcome=outcome)


def test_the_book_says_of_the_untold_wind_what_its_report_says():
    told = " ".join(Path("docs/evidence/results.md").read_text(encoding="utf-8").split())
    frame = pd.read_csv("reports/wind_untold/comparison.csv").set_index("flight")
    within = float(re.search(r"it arrives within ([\d.]+) mm", told)[1])
    found = 1e3 * frame.terminal_miss_m["adaptive/plan"]
    assert found <= within <= 1.05 * found
    assert f"misses the goal by {frame.terminal_miss_m['open_loop/plan']:.0f} m" in told
    for flight in ("adaptive/plan", "adaptive/quintic"):
        assert f"{frame.energy_J[flight]:.2f} J" in told


@pytest.mark.usefixtures("_no_figures")
def test_replanned_flights_are_told_by_what_they_knew_and_how_long_their_solves_took(tmp_path):
    run = synthetic_run(overrides=("baseline.mpc.interval=0.25",))
    solve = Resolve(t=0.25, arrived_at=0.31, solve_s=0.02, is_converged=True, is_late=False)
    late = Resolve(t=0.5, arrived_at=0.6, solve_s=0.1, is_converged=False, is_late=True)
    run.flights[1].name = "mpc/estimated"
    run.flights[1].resolves = (solve, solve, solve, late)
    text = write(tmp_path, run)
    assert "Every 0.25 s the rest of the mission is planned again" in text
    assert re.search(
        r"\| `mpc/estimated` \| 723.80 \| [\d.e-]+ \| yes \| 4 \| 1 \| 1 \| 0 "
        r"\| 20 \| 88 \| 100 \|",
        text,
    )
    table = pd.read_csv(tmp_path / "replanning.csv")
    assert table["solve_95_percent_s"].tolist() == pytest.approx([0.088])
    assert "breaks a limit" not in text


@pytest.mark.usefixtures("_no_figures")
def test_solves_are_late_by_the_times_that_stand_beside_the_count(tmp_path):
    """The stated clock charges a flight 60 ms for every solve, so that none was late in it."""
    run = synthetic_run(overrides=("baseline.mpc.interval=0.2",))
    run.flights[1].name = "mpc/told"
    run.flights[1].resolves = tuple(
        Resolve(t=0.2 * k, arrived_at=0.2 * k + 0.06, solve_s=s, is_converged=True, is_late=False)
        for k, s in enumerate((0.05, 0.0601, 0.19, 0.201, 0.375))
    )
    text = write(tmp_path, run)
    (row,) = pd.read_csv(tmp_path / "replanning.csv").to_dict("records")
    assert (row["solves"], row["late"], row["beyond_interval"]) == (5, 4, 2)
    assert row["solve_longest_s"] == 0.375
    assert "| Slower than 60 ms | Slower than the interval of 200 ms |" in text
    assert "only with a computer on which no solve is slower" in text


@pytest.mark.usefixtures("_no_figures")
def test_the_limit_that_a_flight_breaks_stands_below_the_table(tmp_path):
    run = synthetic_run(overrides=("baseline.mpc.interval=0.25",))
    flight = run.flights[1]
    flight.broken_limits = ("zones.keep_out[mast] by 0.085 m",)
    kept = run.comparison["flight"] != flight.name
    run.comparison["limits_kept"] = kept
    text = write(tmp_path, run)
    line = f"{flight.name} breaks a limit: zones.keep_out[mast] by 0.085 m (planned without mission"
    assert line in text.replace("\\", "")
    # In a narrow column a name goes on behind its joints, and nowhere else.
    page = render_html(line, is_good=True, pictures={}, views={}, data="")
    assert "zones.<wbr>keep_<wbr>out[mast]" in page


@pytest.mark.lengthy
def test_without_replanning_the_report_does_not_speak_of_it(report):
    assert "Re-planning" not in (report / "report.md").read_text()
    assert not (report / "replanning.csv").exists()
