# %% [markdown]
# A mission of your own, from Python: solve it, look at it, hand it to an autopilot.
# Run this file whole, or cell by cell in an editor that knows `# %%`.

# %% A scenario is nested mappings, as in a TOML file; what is not said has a default.
from pyomo_quad import export_plan, load_scenario, solve

scenario = load_scenario(
    {
        "name": "worked_mission",
        "vehicle": {"use": "dji_phantom_2", "payload": 0.2},
        "wind": {"use": "constant", "speed": 4.0, "direction": 1.57, "coupling": "drag"},
        "mission": {"goal": {"position": [20.0, 0.0, 5.0]}, "duration": 12.0},
        "power": {"model": "motor"},
    }
)

# %% The plan of least energy, flown by SciPy to check it.
plan = solve(scenario)
print(plan)  # in a notebook, `plan` alone shows a table

# %% As a pandas table, 20 rows a second.
frame = plan.to_frame(rate_hz=20.0)
print(frame[["x_m", "z_m", "theta_rad", "power_W"]].iloc[::40].round(3).to_string())

# %% A minute's hover, and a charge of the battery, are what people measure energy by.
hover_power = plan.hover_energy_J / scenario.mission.duration
print(f"{plan.energy:.0f} J: as much as hovering for {plan.energy / hover_power:.1f} s")

# %% To PX4's offboard mode, and to a Crazyflie swarm; each says how far it is from the plan.
print(export_plan(plan, "px4", "worked_mission_px4.csv"))
print(export_plan(plan, "crazyflie", "worked_mission_crazyflie.csv", path_error_m=0.01))
