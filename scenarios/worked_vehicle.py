# %% [markdown]
# A vehicle of your own from its flights: what it draws, how far it comes, what a mission takes.

# %% The commands, called from Python; 120 flights of a DJI Matrice 100 stand for yours.
from pathlib import Path

from pyomo_quad import solve
from pyomo_quad.cli import main

FLIGHTS = Path(__file__).parent / "flights" / "m100"
MISSION = Path("worked_vehicle.toml")
MISSION.write_text("""
name = "worked_vehicle"
vehicle = { use = "identified/vehicle.toml", payload = 0.25 }
battery = { use = "matrice_100_pack" }
wind = { use = "constant", speed = 5.0, direction = 3.14, coupling = "drag" }
power = { model = "momentum" }
mission = { goal = { position = [100, 0, 10] }, duration = 16 }
""")

# %% Its power, fitted to the flights, and how far to trust it: identified/report.md.
logs = [str(FLIGHTS / "flights.parquet"), "--flights", str(FLIGHTS / "flight_list.csv")]
main(["identify", *logs, "--base", "dji_matrice_100", "--out", "identified"])

# %% What steady flight costs it, and the speeds to fly at: polar/report.md.
main(["polar", str(MISSION), "--out", "polar"])

# %% A mission of least energy by the same numbers.
plan = solve(MISSION)
print(f"{plan.energy:.0f} J for the mission, {plan.hover_energy_J:.0f} J for hovering as long")
