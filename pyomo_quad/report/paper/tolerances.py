"""How far a committed number may drift before a test fails."""

from dataclasses import dataclass

__all__ = ["TOLERANCES", "Tolerance"]


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """Largest relative difference between a committed and a regenerated number.

    ``scope`` says to whom it applies, ``columns`` names the columns of the table.
    """

    table: str
    columns: tuple[str, ...]
    relative: float
    scope: str


TOLERANCES = (
    Tolerance(
        table="experiments",
        columns=("energy_J", "hover_energy_J"),
        relative=1e-4,
        scope="every flight whose solve converged, also on a coarse mesh",
    ),
    Tolerance(
        table="wind",
        columns=("energy_J", "hover_energy_J"),
        relative=1e-4,
        scope="every flight whose solve converged, also on a coarse mesh",
    ),
    Tolerance(
        table="baselines",
        columns=("energy_J", "optimum_J"),
        relative=1e-4,
        scope="every flight",
    ),
    Tolerance(
        table="batteries",
        columns=("stored_energy_J", "hover_power_W", "greatest_power_W"),
        relative=1e-6,
        scope="every pack",
    ),
    Tolerance(table="floors", columns=("floor_J",), relative=1e-3, scope="every finite floor"),
)
