"""What Pyomo does once and slowly: put off until it is needed, or kept from run to run."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def _unseen(*names: str) -> Iterator[None]:
    """Let a block find that libraries have not been imported."""
    held = {name: sys.modules.pop(name) for name in names if name in sys.modules}
    try:
        yield
    finally:
        sys.modules.update(held)


# What it finds it completes at once, as `pyomo_unaware` says.
with _unseen("scipy", "matplotlib"):
    from pyomo.common import dependencies
from pyomo.core.base.units_container import PyomoUnitsContainer, units  # noqa: E402  after Pyomo's dependencies


@contextmanager
def pyomo_unaware() -> Iterator[None]:
    """Let a block import SciPy or matplotlib without what Pyomo adds as soon as it sees them.

    That is `scipy.stats` and `matplotlib.pyplot`, half a second each; Pyomo still adds them where
    it makes use of either.
    """
    watchers = [f for f in sys.meta_path if type(f).__module__ == dependencies.__name__]
    for watcher in watchers:
        sys.meta_path.remove(watcher)
    try:
        yield
    finally:
        sys.meta_path[:0] = watchers


@contextmanager
def _dask_unseen() -> Iterator[None]:
    """Let a block import pint without Dask, which pint adds where it is installed."""
    if "dask" in sys.modules:
        yield
        return
    sys.modules["dask"] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules["dask"]


# Before any room of the package, and pint, import a part of SciPy.
with pyomo_unaware(), _dask_unseen():
    import pint
    import scipy  # noqa: F401


def _unit_registry() -> "pint.UnitRegistry[Any]":
    """Return pint's own registry, whose definitions take 0.2 s to parse and are kept for that."""
    try:
        return pint.UnitRegistry(cache_folder=":auto:")
    except Exception:  # noqa: BLE001  whatever is wrong with the user's cache, do without it
        return pint.UnitRegistry()


# Units that are in use already belong to the registry that made them.
if type(units) is not PyomoUnitsContainer:
    units.set_pint_registry(_unit_registry())
