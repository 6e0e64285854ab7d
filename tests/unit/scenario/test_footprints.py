"""Polygons on the ground: their convex parts, their limits in the model, fences and GeoJSON."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyomo.environ import value
from shapely import Point, Polygon, union_all

from pyomo_quad.flight.routes import find_routes
from pyomo_quad.model import build_model
from pyomo_quad.scenario import ScenarioError, load_scenario
from pyomo_quad.scenario.airspace import KeepIn, KeepOut
from pyomo_quad.scenario.earth import GeodeticOrigin
from pyomo_quad.scenario.footprints import convex_parts, read_footprints

ORIGIN = {"latitude": 47.3977, "longitude": 8.5456, "altitude": 488.0}
BELL = [[10.0, -4.0], [16.0, -4.0], [16.0, 8.0], [14.0, 8.0], [14.0, 3.0], [10.0, 3.0]]
TALL = {"bottom": -9.0, "top": 40.0}
MISSION = {
    "start": {"position": [0.0, 0.0, 5.0]},
    "goal": {"position": [30.0, 0.0, 5.0]},
    "duration": 14.0,
}


def told(**airspace):
    mission = MISSION | {"origin": ORIGIN}
    return load_scenario({"name": "p", "mission": mission, "airspace": airspace})


def polygon(corners, **changed):
    return {"name": "yard", "shape": "polygon", "corners": corners} | TALL | changed


def stars(count, seed):
    """Corners of a polygon that does not cross itself, at random distances all round a place."""
    generator = np.random.default_rng(seed)
    angles = np.sort(generator.choice(60, count, replace=False)) * 2 * np.pi / 60
    radii = generator.uniform(5.0, 40.0, count)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]).tolist()


@settings(max_examples=40, deadline=None)
@given(count=st.integers(3, 14), seed=st.integers(0, 2**16))
def test_convex_parts_cover_a_polygon_and_nothing_else(count, seed):
    whole = Polygon(stars(count, seed))
    if not whole.is_valid or whole.area < 1.0:
        return
    parts = [Polygon(part) for part in convex_parts(whole)]
    assert sum(part.area for part in parts) == pytest.approx(whole.area, rel=1e-9)
    assert union_all(parts).symmetric_difference(whole).area < 1e-6 * whole.area
    assert all(part.convex_hull.area == pytest.approx(part.area, rel=1e-6) for part in parts)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    place=st.tuples(*[st.floats(-50, 50)] * 2),
    is_turned=st.booleans(),
)
def test_depth_and_room_are_distances_from_the_edges(seed, place, is_turned):
    hull = Polygon(stars(9, seed)).convex_hull
    ring = list(hull.exterior.coords[:-1])
    corners = ring[::-1] if is_turned else ring
    zone = KeepOut.model_validate(polygon(corners))
    fence = KeepIn(corners=corners)
    inside = hull.contains(Point(place))
    distance = hull.exterior.distance(Point(place))
    at = np.array([*place, 10.0])
    if inside:
        assert fence.depth(at) == pytest.approx(distance, abs=1e-9)
        assert zone.depth(at) == pytest.approx(min(distance, 19.0), abs=1e-9)
    elif distance > 1e-9:
        assert -distance - 1e-9 <= fence.depth(at) < 0.0
        assert -distance - 1e-9 <= zone.depth(at) < 0.0


def test_a_rectangle_is_limited_as_a_box_is():
    box = {"name": "yard", "shape": "box", "low": [10.0, -4.0, -9.0], "high": [16.0, 3.0, 40.0]}
    ring = [[10.0, -4.0], [16.0, -4.0], [16.0, 3.0], [10.0, 3.0]]
    models = [
        build_model(told(keep_out=[zone], clearance=0.5))
        for zone in (box, polygon(ring), polygon(ring[::-1]))
    ]
    generator = np.random.default_rng(0)
    for _ in range(20):
        limits = []
        place = generator.uniform((5, -9, -15), (20, 9, 45))
        for m in models:
            body, t = m.rigid_body, m.time.first()
            for axis, coordinate in zip("xyz", place, strict=True):
                body.component(axis)[t] = coordinate
            limits.append(value(m.airspace.keep_out["yard", t].body))
        assert limits == pytest.approx([limits[0]] * 3, abs=1e-9)


@pytest.mark.lengthy
def test_a_slanted_polygon_forbids_what_is_inside_and_little_more():
    ring = [[10.0, -4.0], [17.0, -1.0], [15.0, 6.0], [9.0, 4.0]]
    m = build_model(told(keep_out=[polygon(ring)]))
    t, shape = m.time.first(), Polygon(ring)
    m.rigid_body.z[t] = 10.0
    for x in np.arange(6.0, 20.0, 0.9):
        for y in np.arange(-6.0, 9.0, 1.1):
            m.rigid_body.x[t], m.rigid_body.y[t] = x, y
            room = value(m.airspace.keep_out["yard", t].body)
            if shape.contains(Point(x, y)):
                assert room < 0.0
            elif shape.distance(Point(x, y)) > 0.3:
                assert room > 0.0


def test_a_polygon_that_is_not_convex_becomes_zones_that_leave_no_gap():
    scenario = told(keep_out=[polygon(BELL)])
    assert [zone.name for zone in scenario.airspace.keep_out] == ["yard-1", "yard-2"]
    for x, y in ((11, 0), (15, 7), (14, 2.9), (15, 3)):
        place = np.array([x, y, 5.0])
        assert max(zone.depth(place) for zone in scenario.airspace.keep_out) >= 0.0
    assert max(z.depth(np.array([11.0, 6.0, 5.0])) for z in scenario.airspace.keep_out) < 0.0
    again = type(scenario).model_validate(scenario.model_dump(mode="json"))
    assert again.airspace == scenario.airspace
    routes = find_routes(scenario.airspace, (0.0, 0.0, 5.0), (30.0, 0.0, 5.0))
    shape = Polygon(BELL)
    for route in routes:
        for here, there in zip(route.places[:-1], route.places[1:], strict=True):
            for share in np.linspace(0, 1, 50):
                x, y, z = here + share * (there - here)
                assert not shape.contains(Point(x, y)) or not -9 < z < 40


def test_a_fence_is_exact_beside_its_edges_and_corners():
    corners = [[-5.0, -9.0], [40.0, -12.0], [35.0, 10.0], [-4.0, 7.0]]
    m = build_model(told(keep_in={"corners": corners}))
    t, shape = m.time.first(), Polygon(corners)
    generator = np.random.default_rng(1)
    for x, y in generator.uniform((-10, -15), (45, 15), (60, 2)):
        m.rigid_body.x[t], m.rigid_body.y[t] = x, y
        edges = [m.airspace.keep_in[edge, t] for edge in range(1, 5)]
        room = min(value(edge.upper) - value(edge.body) for edge in edges)
        assert (room > 0.0) == shape.contains(Point(x, y))
        if room > 0.0:
            assert room == pytest.approx(shape.exterior.distance(Point(x, y)), abs=1e-9)


def test_what_a_fence_cuts_off_inwards_is_kept_out_of():
    fence = [[-9.0, -9.0], [40.0, -9.0], [40.0, 9.0], [15.0, 4.0], [-9.0, 9.0]]
    airspace = told(keep_in={"corners": fence}).airspace
    shape = Polygon(fence)
    assert [zone.name for zone in airspace.keep_out] == ["fence-1"]
    for x in np.arange(-8.5, 40, 1.7):
        for y in np.arange(-8.5, 9, 1.3):
            place = np.array([x, y, 100.0])
            is_inside = airspace.keep_in.depth(place) > 0 and airspace.keep_out[0].depth(place) < 0
            assert is_inside == shape.contains(Point(x, y))


@pytest.mark.parametrize(
    ("airspace", "line"),
    [
        (
            {"keep_in": {"corners": [[1, -9], [40, -9], [40, 9], [1, 9]]}},
            "start.position = .* outside the fence",
        ),
        ({"keep_out": [polygon([[1, 1], [5, 5], [1, 5], [5, 1]])]}, "without crossing itself"),
        ({"keep_out": [polygon([[1, 1], [5, 5], [9, 9]])]}, "encloses an area of 0 m"),
        (
            {"keep_out": [polygon([[1, 1], [5, 5]])]},
            "corners = .*; must be a list of at least 3 values",
        ),
        ({"keep_out": [polygon(BELL[:3], top=-20.0)]}, "top must be above bottom"),
        ({"keep_out": [polygon(BELL[:3], radius=2.0)]}, "polygon yard has .*; remove radius"),
        ({"file": "none.geojson"}, r"airspace.file = .none.geojson.; cannot be read \(No such"),
    ],
)
def test_polygons_that_cannot_be_are_refused(airspace, line):
    with pytest.raises(ScenarioError, match=line) as caught:
        told(**airspace)
    assert "\n" not in str(caught.value)


def feature(ring, kind="Polygon", **properties):
    held = [[*ring, ring[0]]] if kind == "Polygon" else [[[*ring, ring[0]]]] * 2
    geometry = {"type": kind, "coordinates": held}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def collection(file, *features):
    file.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)}))
    return file


def on_globe(ring):
    globe = GeodeticOrigin.model_validate(ORIGIN).geodetic(np.array([[*c, 0.0] for c in ring]))
    return [[longitude, latitude] for latitude, longitude, _ in globe.tolist()]


def test_footprints_of_geojson_are_zones_in_metres(tmp_path):
    square = [[10.0, -4.0], [16.0, -4.0], [16.0, 3.0], [10.0, 3.0]]
    file = collection(
        tmp_path / "zones.geojson",
        feature(on_globe(square), name="hall no. 1", top=12.5),
        feature(on_globe(BELL), height=30, min_height=2),
    )
    origin = GeodeticOrigin.model_validate(ORIGIN)
    zones = [KeepOut.model_validate(zone) for zone in read_footprints(file, "zones", origin)]
    assert [zone.name for zone in zones] == ["hall_no._1", "zone2-1", "zone2-2"]
    assert (zones[0].bottom, zones[0].top) == (0.0, 12.5)
    assert (zones[1].bottom, zones[1].top) == (2.0, 30.0)
    assert Polygon(zones[0].corners).symmetric_difference(Polygon(square)).area < 1e-3
    both = union_all([Polygon(zone.corners) for zone in zones[1:]])
    assert both.symmetric_difference(Polygon(BELL)).area < 1e-3
    tables = {"name": "p", "mission": MISSION | {"origin": ORIGIN}}
    scenario = load_scenario(tables | {"airspace": {"file": str(file)}})
    assert len(scenario.airspace.keep_out) == 3
    again = scenario.with_values({"mission.duration": 15.0})
    assert again.airspace.keep_out == scenario.airspace.keep_out
    record = type(scenario).model_validate(scenario.model_dump(mode="json"))
    assert record.with_values({"mission.duration": 15.0}).airspace == scenario.airspace


_RING = [[8.5, 47.3], [8.6, 47.3], [8.6, 47.4]]


@pytest.mark.parametrize(
    ("features", "line"),
    [
        ([feature(_RING)], "feature 1; has no top; give top or height in m above the origin"),
        ([feature(_RING, top="high")], "has top = .high.; give top or height"),
        ([feature(_RING, kind="Point", top=1)], "is .Point.; must be a Polygon or MultiPolygon"),
        ([feature([[47.3, 98.5], *_RING], top=1)], "GeoJSON gives longitude first, in degrees"),
        ([feature(_RING[:2], top=1)], "not closed, or of fewer than 3 corners"),
        ([feature([[0, 0], [1, 1], [1, 0], [0, 1]], top=1)], "crosses itself or encloses nothing"),
        ([7], "feature 1; has no top"),
    ],
)
def test_geojson_that_cannot_be_is_refused(tmp_path, features, line):
    file = collection(tmp_path / "z.geojson", *features)
    origin = GeodeticOrigin.model_validate(ORIGIN)
    with pytest.raises(ScenarioError, match=line) as caught:
        read_footprints(file, "airspace.file = 'z'", origin)
    assert "\n" not in str(caught.value)
    with pytest.raises(ScenarioError, match=r"is by latitude and longitude; give mission\.origin"):
        read_footprints(file, "airspace.file = 'z'", None)


@settings(max_examples=60, deadline=None)
@given(
    content=st.one_of(
        st.binary(max_size=80),
        st.recursive(
            st.none() | st.floats() | st.text(max_size=5),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(
                    st.sampled_from(["type", "features", "geometry", "coordinates", "properties"]),
                    inner,
                    max_size=4,
                )
            ),
            max_leaves=12,
        ).map(lambda tree: json.dumps({"features": [tree]}).encode()),
    )
)
def test_a_strangers_geojson_is_refused_in_one_line(tmp_path_factory, content):
    file = tmp_path_factory.mktemp("stranger") / "z.geojson"
    file.write_bytes(content)
    origin = GeodeticOrigin.model_validate(ORIGIN)
    with pytest.raises(ScenarioError, match=r"^airspace\.file") as caught:
        read_footprints(file, "airspace.file", origin)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("repeated", [0, 2, 3])
def test_a_corner_given_twice_in_a_row_changes_no_ring(repeated):
    corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]]
    twice = [*corners[: repeated + 1], *corners[repeated:]]
    rings = [KeepOut(**polygon(held)).ring(0.5) for held in (corners, twice)]
    np.testing.assert_allclose(rings[1], rings[0])


def test_a_closed_ring_is_that_of_its_corners():
    corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]]
    rings = [KeepOut(**polygon(held)).ring(0.5) for held in (corners, [*corners, corners[0]])]
    assert Polygon(rings[1]).equals(Polygon(rings[0]))
