"""Zones with polygonal ground plan: division into convex parts, and import from GeoJSON.

The model keeps each place of the flight on the outer side of at least one face's plane. Some places
inside a concave zone would satisfy this condition. A concave polygon is therefore divided into
convex zones NAME-1, NAME-2 and so on. A concave fence becomes its convex hull. The parts of the
hull outside the fence become keep-out zones fence-1, fence-2 and so on.

Error messages on a GeoJSON file begin with the text `place`, which names the scenario field and the
file.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pyomo_quad.scenario.airspace import ENDLESS_M, Shape, is_convex
from pyomo_quad.scenario.earth import GeodeticOrigin
from pyomo_quad.scenario.fields import is_number
from pyomo_quad.scenario.messages import ScenarioError, refuse, shown

_LARGEST_BYTES = 20_000_000
_MOST_FEATURES = 1000
# Distance from a straight line, relative to the extent, below which a corner is on the line.
_STRAIGHT = 1e-9
_FENCE = "fence"
_POLYGON, _MULTIPOLYGON = "Polygon", "MultiPolygon"
_Ring = list[tuple[float, float]]


def in_convex_parts(airspace: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scenario's table `airspace` with concave polygons divided into convex parts.

    A concave fence becomes its convex hull, and the parts of the hull outside the fence become
    keep-out zones. Invalid polygons are kept for the validation, which rejects them.
    """
    divided = dict(airspace)
    zones: list[Any] = []
    written = airspace.get("keep_out", ())
    for zone in written if isinstance(written, list | tuple) else ():
        zones += _parts_of_zone(zone) if isinstance(zone, Mapping) else [zone]
    fence = airspace.get("keep_in")
    polygon = _polygon_of(fence.get("corners")) if isinstance(fence, Mapping) else None
    if polygon is not None and not is_convex(polygon):
        hull, rest = _cut_off(polygon)
        divided["keep_in"] = {**fence, "corners": hull}  # type: ignore[dict-item]
        ends = {"shape": Shape.POLYGON.value, "bottom": -ENDLESS_M, "top": ENDLESS_M}
        zones += [
            {"name": f"{_FENCE}-{k}", "corners": part, **ends}
            for k, part in enumerate(rest, start=1)
        ]
    if zones:
        divided["keep_out"] = zones
    return divided


def _parts_of_zone(zone: Mapping[str, Any]) -> list[Any]:
    polygon = _polygon_of(zone.get("corners")) if zone.get("shape") == Shape.POLYGON else None
    if polygon is None or is_convex(polygon):
        return [zone]
    parts = convex_parts(polygon)
    name = zone.get("name")
    return [
        {**zone, "name": f"{name}-{k}", "corners": part} for k, part in enumerate(parts, start=1)
    ]


def _polygon_of(written: Any) -> Any:  # noqa: ANN401  before validation, and see `is_convex`
    """Convert corners as written in a scenario file to a shapely polygon; None if invalid."""
    from shapely import Polygon  # noqa: PLC0415  for polygons alone

    if not isinstance(written, list | tuple) or len(written) < 3:
        return None
    for corner in written:
        is_pair = isinstance(corner, list | tuple) and len(corner) == 2
        if not is_pair or not all(is_number(n) and abs(n) < 1e9 for n in corner):
            return None
    # An outline is invalid if it crosses itself or encloses no area.
    polygon = Polygon(written)
    return polygon if polygon.is_valid and polygon.area > 0.0 else None


def convex_parts(polygon: Any) -> list[_Ring]:  # noqa: ANN401  see `is_convex`
    """Divide a shapely polygon into convex parts, each a list of corners (x, y) in order.

    The method of Hertel and Mehlhorn (1983) gives at most four times the least number of parts. The
    polygon may have holes.
    """
    from shapely import Polygon, constrained_delaunay_triangles  # noqa: PLC0415  see `_polygon_of`

    # The polygon is triangulated. Neighbouring parts are merged as long as their union is convex.
    parts = [Polygon(t.exterior) for t in constrained_delaunay_triangles(polygon).geoms]
    is_merged = True
    while is_merged:
        is_merged = False
        for first in range(len(parts)):
            for second in range(first + 1, len(parts)):
                both = parts[first].union(parts[second])
                if both.geom_type != _POLYGON or both.interiors:
                    continue
                if is_convex(both):
                    parts[first] = Polygon(_plain(both))
                    del parts[second]
                    is_merged = True
                    break
            if is_merged:
                break
    return [_plain(part) for part in parts]


def _plain(polygon: Any) -> _Ring:  # noqa: ANN401  see `is_convex`
    """Return the corners (x, y) of a shapely polygon's outline, in order.

    Corners on the straight line between their two neighbours are left out.
    """
    ring = [(float(x), float(y)) for x, y in polygon.exterior.coords[:-1]]
    extent = polygon.area
    kept = []
    for k, (x, y) in enumerate(ring):
        (x0, y0), (x1, y1) = ring[k - 1], ring[(k + 1) % len(ring)]
        if abs((x - x0) * (y1 - y) - (y - y0) * (x1 - x)) > _STRAIGHT * extent:
            kept.append((x, y))
    return kept


def _cut_off(polygon: Any) -> tuple[_Ring, list[_Ring]]:  # noqa: ANN401  see `is_convex`
    """Return the convex hull of a concave fence, and convex parts of the hull outside the fence.

    The hull and each part are lists of corners (x, y).
    """
    from shapely import Polygon  # noqa: PLC0415  see `_polygon_of`

    hull = polygon.convex_hull
    rest = hull.difference(polygon)
    pieces = rest.geoms if hasattr(rest, "geoms") else [rest]
    parts = [part for piece in pieces for part in convex_parts(Polygon(_plain(piece)))]
    return _plain(hull), parts


def read_footprints(file: Path, place: str, origin: GeodeticOrigin | None) -> list[dict[str, Any]]:
    """Read keep-out zones from a GeoJSON file (RFC 7946) in longitude and latitude (WGS 84).

    Each zone is a table `airspace.keep_out`, as in a scenario file. A concave polygon gives several
    zones. `origin` is the position of x = y = z = 0 on earth. Raises ScenarioError, which begins
    with `place`, if the file is not valid or `origin` is None.
    """
    features = _features(file, place)
    if origin is None:
        refuse(place, "is by latitude and longitude; give mission.origin")
    zones: list[dict[str, Any]] = []
    for number, feature in enumerate(features, start=1):
        properties = feature.get("properties") if isinstance(feature, Mapping) else None
        told = properties if isinstance(properties, Mapping) else {}
        name = told.get("name")
        name = name if isinstance(name, str) and name else f"zone{number}"
        where = f"{place}, feature {number}"
        # Heights are in m above the origin.
        bottom = _height(told, ("bottom", "min_height"), 0.0, where)
        top = _height(told, ("top", "height"), None, where)
        for part, rings in enumerate(_polygons(feature, where), start=1):
            parts = convex_parts(_in_metres(rings, origin, where))
            for piece, ring in enumerate(parts, start=1):
                tail = [str(n) for n, of in ((part, part > 1), (piece, len(parts) > 1)) if of]
                zones.append(
                    {
                        "name": "-".join([_as_name(name), *tail]),
                        "shape": Shape.POLYGON.value,
                        "corners": [list(corner) for corner in ring],
                        "bottom": bottom,
                        "top": top,
                    }
                )
    return zones


def _as_name(text: str) -> str:
    """Convert a text to a valid zone name of at most 40 characters.

    Characters that are not allowed in names become underscores. Different texts may give the same
    name.
    """
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in text)
    return kept[:40] if kept[0].isalnum() else f"zone{kept[:36]}"


def _features(file: Path, place: str) -> list[Any]:
    try:
        if file.stat().st_size > _LARGEST_BYTES:
            refuse(place, f"larger than {_LARGEST_BYTES} bytes; cut out what is flown past")
        held = json.loads(file.read_text(encoding="utf-8-sig"))
    except OSError as error:
        refuse(place, f"cannot be read ({error.strerror or error}); give an existing file")
    except (ValueError, RecursionError) as error:
        if isinstance(error, ScenarioError):
            raise
        refuse(place, "is not JSON; save it as GeoJSON")
    features = held.get("features") if isinstance(held, Mapping) else None
    if not isinstance(features, list):
        refuse(place, "is no FeatureCollection of GeoJSON; save it as one")
    if len(features) > _MOST_FEATURES:
        refuse(place, f"has {len(features)} features; must have at most {_MOST_FEATURES}")
    return features


def _height(
    told: Mapping[str, Any], names: tuple[str, str], otherwise: float | None, where: str
) -> float:
    value = next((told[name] for name in names if told.get(name) is not None), otherwise)
    if not is_number(value) or not abs(value) <= ENDLESS_M:
        said = f"{names[0]} = {shown(value)}" if value is not None else f"no {names[0]}"
        refuse(where, f"has {said}; give {names[0]} or {names[1]} in m above the origin")
    return float(value)


def _polygons(feature: Any, where: str) -> Iterator[list[Any]]:  # noqa: ANN401  untrusted
    """Yield the rings (closed outlines) of each polygon of a GeoJSON feature, outer ring first.

    Raises a ScenarioError, which begins with `where`, if the feature is not a polygon or
    multipolygon.
    """
    geometry = feature.get("geometry") if isinstance(feature, Mapping) else None
    told = geometry if isinstance(geometry, Mapping) else {}
    kind, held = told.get("type"), told.get("coordinates")
    if kind not in {_POLYGON, _MULTIPOLYGON} or not isinstance(held, list) or not held:
        refuse(where, f"is {shown(kind or 'no geometry')}; must be a {_POLYGON} or {_MULTIPOLYGON}")
    for rings in [held] if kind == _POLYGON else held:
        if not isinstance(rings, list) or not rings:
            refuse(where, f"has a {_POLYGON} without a ring; correct it")
        yield rings


def _in_metres(rings: list[Any], origin: GeodeticOrigin, where: str) -> Any:  # noqa: ANN401
    """Convert a GeoJSON polygon's rings, in degrees, to a shapely polygon in metres.

    The first ring is the outline, the others are holes. Error messages begin with `where`.
    """
    from shapely import Polygon  # noqa: PLC0415  see `_polygon_of`

    found = []
    for ring in rings:
        try:
            globe = [(float(corner[1]), float(corner[0]), 0.0) for corner in ring]
        except (TypeError, ValueError, LookupError):
            globe = []
        if len(globe) < 4 or globe[0] != globe[-1]:
            refuse(where, "has a ring that is not closed, or of fewer than 3 corners; correct it")
        if any(not (abs(lat) <= 90.0 and abs(lon) <= 180.0) for lat, lon, _ in globe):
            refuse(
                where,
                "has a corner beyond 90 degrees of latitude or 180 of longitude; GeoJSON gives "
                "longitude first, in degrees",
            )
        found.append([(float(x), float(y)) for x, y, _ in origin.local(globe[:-1])])
    polygon = Polygon(found[0], found[1:])
    if not polygon.is_valid or polygon.area <= 0.0:
        refuse(where, "has a polygon that crosses itself or encloses nothing; correct it")
    return polygon
