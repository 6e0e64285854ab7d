"""What holds of every mission: its mirror image is flown alike, and a zone saves nothing."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from pyomo_quad.flight import Planner
from tests.declared_model import scenario

# Of the energy, which plans to this tolerance of the states keep.
TOLERANCE = 1e-5
MIRRORED = {"left": "right", "right": "left"}


@dataclass(frozen=True)
class Drawn:
    """A random mission past a waypoint, with a zone beside the first leg, in a steady wind."""

    start: tuple
    place: tuple
    goal: tuple
    centre: tuple
    radius: float
    direction: float
    duration: float | str

    def planned(self, *, is_mirrored=False, centres=None, **mission):
        """Fly it, or its mirror image in the plane x = y.

        In that plane the vehicle is its own image: the arms change places with those of rotors
        that spin the other way.  In the plane of x and z their spins would be wrong.
        """

        def on_side(place):
            x, y, *height = place
            return [y, x, *height] if is_mirrored else [x, y, *height]

        direction = np.pi / 2 - self.direction if is_mirrored else self.direction
        mast = {"shape": "cylinder", "bottom": 0.0, "radius": self.radius}
        masts = [
            mast | {"name": f"mast_{k}", "centre": on_side(centre), "top": 30.0}
            for k, centre in enumerate((self.centre,) if centres is None else centres)
        ]
        told = scenario(
            mission={
                "start": {"position": on_side(self.start)},
                "goal": {"position": on_side(self.goal)},
                "waypoints": [{"position": on_side(self.place)}],
                "duration": self.duration,
            }
            | mission,
            wind={
                "use": "constant",
                "speed": 2.0,
                "direction": direction,
                "coupling": "drag",
            },
            airspace={"keep_out": masts},
            solver={"tolerance": TOLERANCE},
        )
        plan = Planner().solve(told)
        assert plan.is_verified
        return plan


def drawn(seed, duration=8.0):
    random = np.random.default_rng(seed)
    start, place, goal = (
        np.array([x, *random.uniform((-2.0, 3.0), (2.0, 6.0))]) for x in (0.0, 8.0, 14.0)
    )
    middle = (start + place) / 2
    aside = random.uniform(0.1, 0.4) * random.choice([-1.0, 1.0])
    return Drawn(
        start=tuple(start),
        place=tuple(place),
        goal=tuple(goal),
        centre=(middle[0], middle[1] + aside),
        radius=random.uniform(0.5, 1.2),
        direction=random.uniform(0.0, 2 * np.pi),
        duration=duration,
    )


def words(plan):
    return next(route.name for route in plan.routes if route.is_kept).split()


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "duration"), [(1, 8.0), (2, 8.0), (3, "free")])
def test_a_mirror_image_has_the_mirror_image_route(seed, duration):
    told = drawn(seed, duration)
    plan, image = told.planned(), told.planned(is_mirrored=True)
    assert image.energy == pytest.approx(plan.energy, rel=TOLERANCE)
    assert image.passing_times_s == pytest.approx(plan.passing_times_s, abs=5e-3)
    assert [MIRRORED.get(word, word) for word in words(image)] == words(plan)
    shares = np.linspace(0.0, 1.0, 19)
    names = plan.trajectories.state_names
    flown, mirrored = (
        one.trajectories.states_at(shares * one.duration_s)[
            :, [names.index(f"rigid_body.{axis}") for axis in axes]
        ]
        for one, axes in ((plan, "xyz"), (image, "yxz"))
    )
    assert mirrored == pytest.approx(flown, abs=2e-2)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "duration"), [(1, 8.0), (4, 7.0)])
def test_adding_a_keep_out_never_lowers_the_energy(seed, duration):
    told = drawn(seed, duration)
    plans = [told.planned(centres=())]
    times = plans[0].passing_times_s[0] / 2, (plans[0].passing_times_s[0] + plans[0].duration_s) / 2
    # Masts where the flight without them goes, on the one leg and on the other.
    on_the_way = [plans[0].at(time)[["x_m", "y_m"]].tolist() for time in times]
    plans += [told.planned(centres=on_the_way[:count]) for count in (1, 2)]
    for less, more in pairwise(plan.energy for plan in plans):
        assert more > less * (1 + TOLERANCE)
