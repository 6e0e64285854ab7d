# %% [markdown]
# What does the optimum save, and how sure is that? A run from Python.

# %% The paper's mission in 6 s, against a controller that follows a quintic.
from pathlib import Path

from pyomo_quad import load_scenario, run_scenario

HERE = Path(__file__).parent
scenario = load_scenario(
    HERE / "paper_wind.toml", {"mission.duration": 6.0, "baseline.references": ["quintic"]}
)
result = run_scenario(scenario)
print(result)  # in a notebook, `result` alone shows a table

# %% Every flight of the run, its energy and whether it arrived.
print(result.comparison[["flight", "energy_J", "saving_percent", "arrived"]].to_string())

# %% No flight of this mission can spend less than the bound.
print(f"bound {result.certificate.lower_bound_J:.2f} J, gap {result.gap_percent:.2f} %")

# %% One of the flights, as a table against time.
optimal, controlled, *_ = result.flights
print(f"{controlled.name} ends {1000 * controlled.terminal_miss_m:.1f} mm from the goal")
