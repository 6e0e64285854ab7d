"""Make the terrain and the wind of scenarios/ridge.toml: a ridge of three hills, and air over it.

Each hill is a bell (Smith 1980), and their sum is the ridge:

    h(x, y) = sum_k H_k / (1 + r_k^2 / a^2)^(3/2),    r_k^2 = (x - x_k)^2 + (y - y_k)^2

The air is that of linear potential flow, which is Smith's solution without stratification: the
streamlines of a wind U, given far from the ridge, are lifted by eta(x, y, z), a harmonic function
which is h at z = 0 and vanishes aloft.  Of each hill, with R_k^2 = r_k^2 + (a + z)^2,

    eta_k = H_k a^2 (a + z) / R_k^3,
    velocity = U + grad(phi),    phi = a^2 sum_k H_k U.(r - r_k) / R_k^3

so that phi is a dipole a metres below the foot of each hill.  The velocity has neither divergence
nor curl; over the crests it is faster, before them it rises, and in the pass it is faster than over
the plain.  It is linear in the slope (at most 0.3 here), has neither boundary layer nor wake, and
below the ground, where no flight reads it, it is only a smooth continuation.

Smith, R. B., "Linear theory of stratified hydrostatic flow past an isolated mountain", Tellus 32
(1980), 348-364.

Run `python scenarios/ridge/make_data.py` to write `terrain.nc` and `wind.nc` beside it.
"""

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

#: x, y and height of each hill, m, and their common width, m.
HILLS = ((1050.0, -480.0, 70.0), (1000.0, 60.0, 60.0), (960.0, 600.0, 70.0))
WIDTH_M = 200.0
#: The wind far from the ridge, toward east and north, m/s.
WIND = (-5.0, 2.0)


def ground(x: ArrayLike, y: ArrayLike) -> FloatArray:
    """Return the height h of the ground [m]."""
    squares = (((x - east) ** 2 + (y - north) ** 2, high) for east, north, high in HILLS)
    return np.asarray(sum(high / (1 + s / WIDTH_M**2) ** 1.5 for s, high in squares))


def air(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> FloatArray:
    """Return the velocity of the air toward x, y and z [m/s], its components first."""
    blowing = np.array([*WIND, 0.0])
    velocity = [np.full(np.broadcast(x, y, z).shape, speed) for speed in blowing]
    for east, north, high in HILLS:
        off = np.broadcast_arrays(x - east, y - north, z + WIDTH_M)
        square = sum(part**2 for part in off)
        along = blowing[0] * off[0] + blowing[1] * off[1]
        for axis in range(3):
            slope = blowing[axis] - 3 * along * off[axis] / square
            velocity[axis] = velocity[axis] + high * WIDTH_M**2 * slope / square**1.5
    return np.array(velocity)


def terrain_file() -> xr.Dataset:
    """Return the heights of the ground every 40 m."""
    x, y = np.arange(-200.0, 2201.0, 40.0), np.arange(-800.0, 801.0, 40.0)
    heights = ground(x[:, None], y[None, :])
    of = {"standard_name": "surface_altitude", "units": "m"}
    return xr.Dataset({"height": (("x", "y"), heights, of)}, _coordinates(x=x, y=y))


def wind_file() -> xr.Dataset:
    """Return the wind every 80 m, and every 25 m of height."""
    x, y = np.arange(-200.0, 2201.0, 80.0), np.arange(-800.0, 801.0, 80.0)
    z = np.arange(0.0, 226.0, 25.0)
    velocity = air(x[:, None, None], y[None, :, None], z[None, None, :])
    names = ("eastward_wind", "northward_wind", "upward_air_velocity")
    held = {
        name: (("x", "y", "z"), part, {"standard_name": name, "units": "m s-1"})
        for name, part in zip(names, velocity, strict=True)
    }
    return xr.Dataset(held, _coordinates(x=x, y=y, z=z))


def _coordinates(**axes: FloatArray) -> dict[str, object]:
    return {name: (name, points, {"units": "m"}) for name, points in axes.items()}


if __name__ == "__main__":
    folder = Path(__file__).parent
    for name, data in (("terrain", terrain_file()), ("wind", wind_file())):
        small = {held: {"dtype": "float32", "zlib": True} for held in data.data_vars}
        data.to_netcdf(folder / f"{name}.nc", encoding=small)
