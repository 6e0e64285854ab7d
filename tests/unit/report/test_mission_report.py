"""What a report says of a mission's way: the map, the legs, the speed and the front."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Circle, Rectangle
from matplotlib.quiver import Quiver, QuiverKey
from PIL import Image

from pyomo_quad.cli import main
from pyomo_quad.collocation import Status
from pyomo_quad.flight import Planner
from pyomo_quad.report import Figures
from pyomo_quad.report.energy_bars import draw_energy_by_scenario, draw_energy_split
from pyomo_quad.report.flight_figures import (
    draw_energy,
    draw_front,
    draw_power,
    draw_way,
)
from pyomo_quad.report.gallery import comparison_drawings
from pyomo_quad.report.paths import draw_map, draw_path, mean_wind_of
from pyomo_quad.report.report import write_run_report
from pyomo_quad.report.style import HOUSE_STYLE, styled_flights
from pyomo_quad.report.tables import write_table
from pyomo_quad.report.zones import faces
from pyomo_quad.scenario import load_scenario
from pyomo_quad.study.comparison import compare_flights, leg_table
from pyomo_quad.study.front import energy_time_front
from tests.synthetic_run import (
    HOVER_ENERGY_J,
    synthetic_certificate,
    synthetic_run,
    with_tuned_autopilot,
)

ZONES = """[
    {name = "mast", shape = "cylinder", centre = [2.0, 5.0], radius = 1.0, bottom = 0.0, top = 6.0},
    {name = "kite", shape = "sphere", centre = [5.0, 2.0, 3.0], radius = 0.5},
    {name = "shed", shape = "box", low = [4.0, 0.0, 0.0], high = [6.0, 1.0, 2.0]},
]"""
PLACES = """[
    {position = [1.5, 1.75, 2.0], at = 3.0, hold = 1.0}, {position = [4.5, 5.25, 6.0], at = 7.5},
]"""
AIRSPACE = (
    "airspace.floor = -0.5",
    "airspace.ceiling = 9.0",
    "airspace.clearance = 0.25",
    f"airspace.keep_out = {ZONES}",
)
WAYPOINTS = (f"mission.waypoints = {PLACES}",)
OVERRIDES = (*AIRSPACE, *WAYPOINTS)


@pytest.fixture(scope="module")
def run():
    return synthetic_run("scenarios/paper_calm.toml", OVERRIDES, ("optimal", "adaptive/step"))


def test_energies_stand_beside_their_bars_and_not_on_them(run):
    """A flight may take less than hovering: then the bar of hovering reaches beyond its own."""
    flights = styled_flights(run.flights)
    hover = 1.2 * flights[0].energy_J
    whole = draw_energy_split(flights, hover).axes[0]
    ends = [max(hover, flight.energy_J) for flight in flights]
    assert [number.xy[0] for number in whole.texts] == pytest.approx(ends)
    assert [float(number.get_text()) for number in whole.texts] == pytest.approx(
        [flight.energy_J for flight in flights], abs=0.05
    )
    assert whole.get_xlim()[1] > max(ends)


@pytest.fixture(scope="module")
def late():
    """Return a run whose baseline takes 1.5 times as long, and less above its own hover floor."""
    run = synthetic_run("scenarios/paper_calm.toml", AIRSPACE, ("optimal", "adaptive/step"))
    slow = run.flights[1]
    frame = slow.frame
    slow.frame = frame.assign(time_s=1.5 * frame["time_s"], energy_J=1.3 * frame["energy_J"])
    slow.duration_s, slow.energy_J = 1.5 * slow.duration_s, 1.3 * slow.energy_J
    slow.terminal_miss_m, slow.terminal_miss = 0.0, {}
    run.comparison = compare_flights(
        run.scenario, run.flights, synthetic_certificate(), HOVER_ENERGY_J
    )
    first, second = run.comparison["excess_energy_J"]
    assert second < 0.0 < first  # above the floors the dearer flight seems the cheaper
    return run


def test_flights_of_other_durations_are_compared_by_their_total_energy(late):
    flights = styled_flights(late.flights)
    drawn = comparison_drawings(flights, HOVER_ENERGY_J, late.comparison, late.scenario)
    split = drawn[-1].draw()
    spent = [flight.energy_J for flight in late.flights]
    assert [bar.get_width() for bar in split.axes[1].patches] == pytest.approx(
        [0.0, spent[1] - spent[0]]
    )
    bars = draw_energy_by_scenario(late.comparison).axes[0].patches
    assert [bar.get_width() for bar in bars] == pytest.approx(spent)


def test_flights_of_one_duration_are_told_apart_above_hovering(run):
    flights = styled_flights(run.flights)
    above = [flight.energy_J - HOVER_ENERGY_J for flight in flights]
    split = draw_energy_split(flights, HOVER_ENERGY_J)
    assert [bar.get_width() for bar in split.axes[1].patches] == pytest.approx(above)


def test_a_flight_that_missed_the_goal_has_no_bar_and_the_caption_says_so(run):
    """Its energy is not that of the mission: the step ends 0.21 m from the goal."""
    flights = styled_flights(run.flights)
    drawn = comparison_drawings(flights, HOVER_ENERGY_J, run.comparison, run.scenario)
    split = drawn[-1]
    assert [label.get_text() for label in split.draw().axes[0].get_yticklabels()] == ["optimal"]
    assert split.caption.endswith("they missed the goal or broke a limit: adaptive/step.")


def test_the_map_shows_zones_wind_and_the_flight_that_the_saving_is_against():
    run = with_tuned_autopilot(synthetic_run("scenarios/paper_wind.toml", OVERRIDES))
    flights = styled_flights(run.flights)
    drawn = comparison_drawings(flights, HOVER_ENERGY_J, run.comparison, run.scenario)
    assert [one.name for one in drawn] == ["map", "power_over_time", "energy_split"]
    axes = drawn[0].draw().axes[0]
    named = [line.get_label() for line in axes.get_lines() if not line.get_label().startswith("_")]
    assert named == ["optimal", "adaptive/cruise tuned"]
    assert len(axes.patches) >= 2 * len(run.scenario.airspace.keep_out)
    room = axes.get_position().size * axes.get_figure().get_size_inches()
    per_inch = np.ptp([axes.get_xlim(), axes.get_ylim()], axis=1) / room
    assert per_inch[0] == pytest.approx(per_inch[1])
    wind = np.linalg.norm(mean_wind_of(flights[0]))
    assert wind > 0.1
    assert f"wind {wind:.1f} m/s" in [text.get_text() for text in axes.texts]
    arrow = next(text for text in axes.texts if text.arrow_patch is not None)
    tip = np.subtract(arrow.xy, arrow.get_position()) * axes.get_figure().get_size_inches()
    assert tip / np.linalg.norm(tip) == pytest.approx(mean_wind_of(flights[0]) / wind)


def test_time_axes_show_every_flight_to_its_end(late):
    flights = styled_flights(late.flights)
    for figure in (draw_energy(flights, HOVER_ENERGY_J), draw_power(flights, HOVER_ENERGY_J)):
        assert figure.axes[-1].get_xlim() == pytest.approx((0.0, late.flights[1].duration_s))


def test_the_view_in_space_has_one_scale_and_shows_the_zones(run):
    flights, zones = styled_flights(run.flights), run.scenario.airspace.keep_out
    space = draw_path(flights, run.scenario).axes[0]
    sides = np.ptp([space.get_xlim(), space.get_ylim(), space.get_zlim()], axis=1)
    per_metre = space._box_aspect / sides
    assert per_metre == pytest.approx(np.full(3, per_metre[0]))
    assert len(space.collections) == len(zones)
    limits = np.tile([-50.0, 50.0], (3, 1))
    surfaces = {zone.name: faces(zone, limits) for zone in zones}
    for zone in zones:
        assert np.abs(zone.depth(np.concatenate(surfaces[zone.name]))).max() < 1e-12
    areas = {name: sum(map(area, held)) for name, held in surfaces.items()}
    assert areas["shed"] == pytest.approx(2 * (2 * 1 + 2 * 2 + 1 * 2))
    assert areas["mast"] == pytest.approx(2 * np.pi * 1.0 * (6.0 + 1.0), rel=0.01)
    assert areas["kite"] == pytest.approx(4 * np.pi * 0.5**2, rel=0.02)


def area(face):
    """Return the area of a flat polygon: half the sum of the cross products of its corners."""
    return np.linalg.norm(np.cross(face, np.roll(face, -1, axis=0)).sum(axis=0)) / 2


def test_zones_are_cut_off_where_the_picture_ends(run):
    mast = run.scenario.airspace.keep_out[0]
    limits = np.array([(1.0, 2.0), (4.0, 6.0), (2.0, 5.0)])
    cut = faces(mast, limits)
    # Half of the wall is left and neither end.
    assert sum(map(area, cut)) == pytest.approx(np.pi * 1.0 * 3.0, rel=0.01)
    corners = np.concatenate(cut)
    assert np.all((limits[:, 0] - 1e-12 <= corners) & (corners <= limits[:, 1] + 1e-12))


def test_legs_of_an_even_flight_share_way_and_energy_by_their_time(run):
    time = np.linspace(0.0, 10.0, 401)
    frame = pd.DataFrame({"time_s": time, "x_m": 3.0 * time, "y_m": -4.0 * time, "z_m": 0.0 * time})
    legs = leg_table(run.scenario, frame.assign(energy_J=70.0 * time))
    assert legs["leg"].tolist() == ["start to 1", "held at 1", "1 to 2", "2 to goal"]
    lasting = np.array([3.0, 1.0, 3.5, 2.5])
    np.testing.assert_allclose(legs["ended_s"] - legs["begun_s"], lasting)
    np.testing.assert_allclose(legs["length_m"], 5.0 * lasting)
    np.testing.assert_allclose(legs["energy_J"], 70.0 * lasting)


def test_energies_of_the_legs_add_up_to_the_flights(run):
    optimum = styled_flights(run.flights)[0]
    figure = draw_way([optimum], run.scenario)
    bars = [patch.get_width() for patch in figure.axes[1].patches]
    assert len(bars) == 4
    assert sum(bars) == pytest.approx(run.flights[0].energy_J, rel=1e-12)


def test_a_mission_without_waypoints_has_no_legs():
    calm = synthetic_run("scenarios/paper_calm.toml", AIRSPACE, ("optimal",))
    assert leg_table(calm.scenario, calm.flights[0].frame).empty
    assert len(draw_way(styled_flights(calm.flights), calm.scenario).axes) == 1


def test_speed_is_drawn_over_the_way_and_each_flight_keeps_its_colour(run):
    flights = styled_flights(run.flights)
    lines = draw_way(flights, run.scenario).axes[0].get_lines()
    for flight, line in zip(flights, lines, strict=False):
        # Start and goal are (6, 7, 8) m apart, and the path between them is straight.
        assert line.get_xdata()[-1] == pytest.approx(np.sqrt(149.0), rel=1e-6)
        assert line.get_color() == flight.style.color
        slope = np.gradient(line.get_xdata(), flight.frame["time_s"].to_numpy())
        np.testing.assert_allclose(line.get_ydata(), slope, atol=0.05)


def outlines(axes, kind):
    return [patch for patch in axes.patches if isinstance(patch, kind)]


def test_the_map_shows_zones_with_their_clearance_floor_ceiling_and_passing_times(run):
    _, above, front, side = draw_path(styled_flights(run.flights), run.scenario).axes
    circles = {(*c.center, c.radius) for c in outlines(above, Circle)}
    mast, kite = {(2.0, 5.0, 1.0), (2.0, 5.0, 1.25)}, {(5.0, 2.0, 0.5), (5.0, 2.0, 0.75)}
    assert circles == mast | kite
    assert {(*c.center, c.radius) for c in outlines(side, Circle)} == {
        (2.0, 3.0, 0.5),
        (2.0, 3.0, 0.75),
    }
    corners = [tuple(np.ravel(box.get_bbox().get_points())) for box in outlines(front, Rectangle)]
    assert {(1.0, 0.0, 3.0, 6.0), (4.0, 0.0, 6.0, 2.0)} <= set(corners)
    level = {line.get_ydata()[0] for line in front.get_lines() if len(line.get_ydata()) == 2}
    assert {-0.5, 9.0} <= level
    assert {"1: 3.0 s", "2: 7.5 s"} <= {text.get_text() for text in above.texts}
    assert {"1", "2", "floor", "ceiling"} <= {text.get_text() for text in side.texts}
    assert front.get_ylim()[1] > 9.0


def test_a_far_zone_does_not_shrink_the_paths():
    far = 'airspace.keep_out = [{name = "hill", shape = "sphere", centre = [400.0, 0.0, 0.0], '
    run = synthetic_run("scenarios/paper_calm.toml", (far + "radius = 300.0}]",), ("optimal",))
    _, above, *_ = draw_path(styled_flights(run.flights), run.scenario).axes
    assert np.ptp(above.get_xlim()) < 15.0


PRICES = (200.0, 70.0, 0.0)
FRONT = pd.DataFrame(
    {
        "price_of_time_W": PRICES,
        "duration_s": [3.0, 4.0, 5.0],
        "energy_J": [400.0, 330.0, 300.0],
        "is_plan": [False, True, False],
    }
)


def test_the_front_marks_the_plan():
    (axes,) = draw_front(FRONT).axes
    star = next(line for line in axes.get_lines() if line.get_marker() == "*")
    assert (list(star.get_xdata()), list(star.get_ydata())) == ([4.0], [330.0])
    assert [text.get_text() for text in axes.texts] == ["200 W", "70 W", "0 W"]


def test_the_front_is_stored_and_drawn_again(tmp_path, monkeypatch, capsys):
    run = synthetic_run("scenarios/paper_calm.toml", (), ("optimal",))
    run.front = FRONT
    write_run_report(tmp_path, run, Figures.NONE)
    assert "| 70.00 | 4.000 | 330.00 | the plan |" in (tmp_path / "report.md").read_text()
    monkeypatch.chdir(tmp_path)
    summary = '{"hover_energy_J": 700.0}'
    (tmp_path / "summary.json").write_text(summary)
    write_table(run.flights[0].frame, tmp_path / "plan.csv")
    assert main(["plot", str(tmp_path), "front", "--out", "again.png"]) == 0
    with Image.open(tmp_path / "again.png") as picture:
        assert min(picture.size) > 300
    (tmp_path / "front.csv").write_text("duration_s\nlong\n")
    assert main(["plot", str(tmp_path), "front"]) == 2
    said = capsys.readouterr().err
    assert "front.csv: is not the table of an energy-time front; solve the scenario again." in said


class Told:
    """A planner whose flights of T seconds take a / T + b T joules."""

    a, b = 900.0, 100.0

    def solve(self, scenario, **_):
        self.solved, mission = scenario, scenario.mission
        least, greatest = mission.duration_limits
        best = np.sqrt(self.a / (self.b + mission.price_of_time))
        duration = min(max(best, least), greatest)
        energy = self.a / duration + self.b * duration
        return SimpleNamespace(
            scenario=scenario,
            duration_s=duration,
            energy=energy,
            cost=energy + mission.price_of_time * duration,
            hover_energy_J=80.0 * duration,
            is_verified=True,
            verification=object(),
            solution=SimpleNamespace(status=Status.CONVERGED),
            margins={},
        )


class AtTimesLost(Told):
    """A planner whose solve for the highest price fails or ends at a poor local optimum."""

    def __init__(self, status):
        self.status = status

    def solve(self, scenario, **_):
        found = super().solve(scenario)
        if scenario.mission.price_of_time > 200.0:
            found.solution = SimpleNamespace(status=self.status)
            if self.status.is_solved:
                found.cost *= 3.0
        return found


def front_of(*overrides, planner=None):
    planner = planner or Told()
    plan = planner.solve(load_scenario("scenarios/paper_free.toml", list(overrides)))
    return energy_time_front(plan, planner=planner)


def test_the_front_is_that_of_the_flights_of_least_cost():
    front = front_of("mission.price_of_time = 50.0")
    assert front["price_of_time_W"].tolist() == [240.0, 80.0, 50.0, 24.0, 0.0]
    assert front.loc[front["is_plan"], "price_of_time_W"].tolist() == [50.0]
    np.testing.assert_allclose(front["duration_s"], np.sqrt(900 / (100 + front["price_of_time_W"])))
    assert front["energy_J"].is_monotonic_decreasing


@pytest.mark.parametrize("status", [Status.NOT_CONVERGED, Status.CONVERGED])
def test_a_flight_that_is_no_optimum_has_no_point_in_the_front(status):
    front = front_of("mission.price_of_time = 50.0", planner=AtTimesLost(status))
    assert front["price_of_time_W"].tolist() == [80.0, 50.0, 24.0, 0.0]


def test_flights_at_a_limit_of_the_duration_stand_in_the_front_once():
    front = front_of("mission.duration_min = 2.5")
    assert front["duration_s"].tolist() == [2.5, pytest.approx(np.sqrt(900 / 124)), 3.0]


def test_flights_of_the_front_have_the_margins_of_the_plan():
    planner = Told()
    plan = planner.solve(load_scenario("scenarios/paper_free.toml"))
    plan.margins = {"mission.duration_min": 2.6, "limits.roll_max": 0.1}
    front = energy_time_front(plan, planner=planner)
    least = plan.scenario.mission.duration_limits[0] + 2.6
    assert front["duration_s"].min() == pytest.approx(least)
    assert planner.solved.limits.roll_max == pytest.approx(plan.scenario.limits.roll_max - 0.1)


def test_a_fixed_duration_has_no_front():
    plan = SimpleNamespace(is_verified=True, scenario=load_scenario("scenarios/paper_calm.toml"))
    assert energy_time_front(plan, planner=None).empty


@pytest.mark.slow
def test_the_front_of_a_real_mission_has_its_prices_for_slopes():
    planner = Planner()
    hop = ("mission.goal.position = [2.0, 1.0, 0.5]", "solver.tolerance = 1e-4")
    plan = planner.solve(load_scenario("scenarios/paper_free.toml", list(hop)))
    front = energy_time_front(plan, planner=planner)
    assert len(front) == 4
    price, duration, energy = (
        front[name].to_numpy() for name in ("price_of_time_W", "duration_s", "energy_J")
    )
    for k, own in enumerate(price):
        cost = energy + own * duration
        assert np.all(cost >= cost[k] - 1e-4 * energy[k])


@pytest.mark.lengthy
def test_the_map_shows_a_wind_field_in_place_of_its_mean(run):
    told = load_scenario("scenarios/street.toml")
    (axes,) = draw_map(styled_flights(run.flights), told).axes
    (arrows,) = (drawn for drawn in axes.collections if isinstance(drawn, Quiver))
    (key,) = (drawn for drawn in axes.artists if isinstance(drawn, QuiverKey))
    nearest = np.argmin(np.hypot(*(arrows.XY - [200.0, 20.0]).T))
    place = [*arrows.XY[nearest], 15.0]
    drawn = arrows.U[nearest], arrows.V[nearest]
    assert drawn == pytest.approx(Planner().winds_at(told, place)[0], abs=1e-9)
    assert pytest.approx(np.hypot(arrows.U, arrows.V).max()) == key.U
    assert "m/s" in key.text.get_text()


@pytest.fixture
def house_style():
    with mpl.rc_context(HOUSE_STYLE):
        yield


@pytest.mark.usefixtures("house_style")
def test_the_key_of_a_wind_field_lies_within_the_figure(run):
    figure = draw_map(styled_flights(run.flights), load_scenario("scenarios/street.toml"))
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    (key,) = (drawn for drawn in axes.artists if isinstance(drawn, QuiverKey))
    label = key.text.get_window_extent()
    assert label.ymax < figure.bbox.ymax
    assert label.ymin > axes.bbox.ymax


@pytest.mark.usefixtures("house_style")
def test_the_label_beside_a_map_of_hundreds_of_metres_lies_within_the_figure(run):
    figure = draw_map(styled_flights(run.flights), run.scenario)
    (axes,) = figure.axes
    axes.set_ylim(-390.0, 390.0)
    FigureCanvasAgg(figure).draw()
    assert axes.yaxis.label.get_window_extent().xmin > 0.0
