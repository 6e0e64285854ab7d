"""Routes raised over terrain, with climbs and descents on legs that are too low.

A leg is the line between two corners of a route. The floor is the least height above the ground
that the mission allows. A leg that is below the floor anywhere is replaced by a climb, a level part
and a descent. The level part has the greatest height that the floor requires along the leg.
"""

from itertools import pairwise

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.flight.zones import zones_hit
from pyomo_quad.scenario.airspace import Airspace

# Samples of a leg per cell of the terrain's grid.
_LOOKS_PER_CELL = 4
# Height of a raised leg above the floor [m], which allows for deviations from the leg.
_ABOVE_FLOOR_M = 0.5
# Largest height of a single corner above the level part that it replaces, relative to the height
# which the leg climbs.
_HIGHER = 0.1


def over_the_ground(places: FloatArray, airspace: Airspace) -> FloatArray:
    """Return a route raised where its legs are too low over terrain, with additional corners.

    `places` has the corners [m], shape (n, 3). The route is unchanged without terrain or floor, or
    if the raised route would enter a keep-out zone.
    """
    if airspace.ground is None or airspace.floor is None:
        return places
    raised = [places[:1]]
    for ends in pairwise(places):
        raised += [_summits(np.array(ends), airspace, airspace.floor), ends[1][None]]
    found = np.concatenate(raised)
    return places if zones_hit(airspace.keep_out, found, airspace.clearance) else found


def _summits(ends: FloatArray, airspace: Airspace, floor: float) -> FloatArray:
    """Return the corners that must be inserted to raise one leg of a route over terrain.

    The result has shape (n, 3) [m], and n = 0 if the leg is high enough.
    """
    length = float(np.linalg.norm(np.diff(ends[:, :2], axis=0)))
    step = airspace.ground.least_step if airspace.ground is not None else np.inf
    shares = np.linspace(0.0, 1.0, 2 + int(_LOOKS_PER_CELL * length / step))[1:-1]
    looked_at = ends[0] + shares[:, None] * (ends[1] - ends[0])
    needed = looked_at[:, 2] - airspace.height_above_ground(looked_at) + floor + _ABOVE_FLOOR_M
    if not (needed > looked_at[:, 2]).any():
        return np.empty((0, 3))
    first, last = ends[:, 2]
    level = max(float(needed.max()), first, last)
    # Climb and descent are just steep enough to clear the floor.
    climb = max(float(((needed - first) / shares).max()), 0.0)
    descent = max(float(((needed - last) / (1 - shares)).max()), 0.0)
    meeting = (last + descent - first) / (climb + descent)
    top = first + climb * meeting
    # A short level part is left out: the extended climb and descent meet slightly above it.
    if 0.0 < meeting < 1.0 and top - level <= _HIGHER * (level - min(first, last)):
        corners = [(meeting, top)]
    else:
        up = (level - first) / climb if climb > 0.0 else 0.0
        down = 1.0 - ((level - last) / descent if descent > 0.0 else 0.0)
        corners = [(share, level) for share in (up, down) if 0.0 < share < 1.0]
    found = np.array([ends[0] + share * (ends[1] - ends[0]) for share, _ in corners])
    found[:, 2] = [height for _, height in corners]
    return found
