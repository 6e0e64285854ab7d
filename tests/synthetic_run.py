"""A run with plausible numbers that nothing solved: what the report floor is tested on."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd

from pyomo_quad.collocation import ActiveLimit, Diagnosis, Mesh, MeshRecord, Residual
from pyomo_quad.flight import PlanStatus, Verification
from pyomo_quad.flight.failure import Failure
from pyomo_quad.flight.margins import PAPER_PLAN
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.accuracy import FIGURES
from pyomo_quad.scenario.mission import NamedDuration
from pyomo_quad.scenario.tables import CruiseSettings
from pyomo_quad.study.autopilot import TUNED_CRUISE, TriedCruise, Tuning
from pyomo_quad.study.comparison import compare_flights

HOVER_SPEED = 912.27
HOVER_ENERGY_J = 709.6
LOWER_BOUND_J = 708.4
ROTOR_PHASES = (0.0, 0.7, 1.6, 2.4)
STATES = ("x", "y", "z", "vx", "vy", "vz", "phi", "theta", "psi", "p", "q", "r")
FLIGHTS = {
    # name: (energy above hover in J, sharpness of the path, terminal miss in m)
    "optimal": (2.1, 1.0, 3e-7),
    "adaptive/quintic": (14.2, 1.15, 0.004),
    "adaptive/minimum_snap": (19.7, 1.35, 0.003),
    "adaptive/step": (71.0, 2.6, 0.21),
    "open_loop/plan": (2.1, 1.0, 2e-6),
}


def synthetic_frame(scenario, *, excess_J=2.1, sharpness=1.0, samples=401):
    """Fly a smooth polynomial path from start to goal and make up the rest."""
    duration = scenario.mission.duration
    start, goal = (
        np.array(end.position) for end in (scenario.mission.start, scenario.mission.goal)
    )
    time = np.linspace(0.0, duration, samples)
    path, speed, acceleration = _rest_to_rest(time / duration, sharpness)
    position = start + np.outer(path, goal - start)
    velocity = np.outer(speed, goal - start) / duration
    acceleration = np.outer(acceleration, goal - start) / duration**2
    frame = {"time_s": time}
    frame |= dict(zip(("x_m", "y_m", "z_m"), position.T, strict=True))
    names = ("vx_m_per_s", "vy_m_per_s", "vz_m_per_s")
    frame |= dict(zip(names, velocity.T, strict=True))
    phi, theta = -acceleration[:, 1] / 9.81, acceleration[:, 0] / 9.81
    frame |= {"phi_rad": phi, "theta_rad": theta, "psi_rad": 0 * time}
    frame |= {
        "p_rad_per_s": np.gradient(phi, time),
        "q_rad_per_s": np.gradient(theta, time),
        "r_rad_per_s": 0 * time,
    }
    frame |= _rotors(time, acceleration[:, 2])
    frame |= _energy(time, acceleration[:, 2], excess_J)
    frame |= _wind(time, scenario)
    frame |= _electrical(frame)
    return pd.DataFrame(frame)


def _rest_to_rest(phase, sharpness):
    s = np.clip(phase * sharpness, 0, 1)
    path = 10 * s**3 - 15 * s**4 + 6 * s**5
    speed = sharpness * (30 * s**2 - 60 * s**3 + 30 * s**4)
    acceleration = sharpness**2 * (60 * s - 180 * s**2 + 120 * s**3)
    return path, speed, acceleration


def _rotors(time, lift):
    frame = {}
    for rotor, phase in enumerate(ROTOR_PHASES, start=1):
        omega = HOVER_SPEED * np.sqrt(1 + lift / 9.81) + 6 * np.sin(2 * time + phase) * np.sin(
            np.pi * time / time[-1]
        )
        frame[f"omega_{rotor}_rad_per_s"] = omega
    for rotor in range(1, 5):
        omega = frame[f"omega_{rotor}_rad_per_s"]
        frame[f"alpha_{rotor}_rad_per_s2"] = np.gradient(omega, time)
    frame["thrust_N"] = 3.8305e-6 * sum(frame[f"omega_{i}_rad_per_s"] ** 2 for i in range(1, 5))
    return frame


def _energy(time, lift, excess_J):
    power = 70.96 * (1 + lift / 9.81) ** 1.5
    power += (HOVER_ENERGY_J + excess_J - np.trapezoid(power, time)) / time[-1]
    steps = np.diff(time) * (power[1:] + power[:-1]) / 2
    return {"power_W": power, "energy_J": np.concatenate([[0.0], np.cumsum(steps)])}


def _wind(time, scenario):
    axes = {"x": scenario.wind.x, "y": scenario.wind.y}
    return {
        f"wind_{name}_m_per_s": axis.mean
        + sum(a * np.sin(f * time) for a, f in zip(axis.amplitudes, axis.frequencies, strict=True))
        + 0 * time
        for name, axis in axes.items()
    }


def _electrical(frame):
    current = frame["power_W"] / 12.2
    charge = np.cumsum(current) * (frame["time_s"][1] - frame["time_s"][0]) / 3600
    columns = {
        "battery_current_A": current,
        "battery_voltage_V": 12.58 - 0.0519 * current - 0.2 * charge,
        "state_of_charge_percent": 100 * (1 - charge / 5.2),
    }
    for rotor in range(1, 5):
        omega = frame[f"omega_{rotor}_rad_per_s"]
        torque = 4.1904e-5 * frame[f"alpha_{rotor}_rad_per_s2"] + 2.2518e-8 * omega**2
        columns[f"motor_{rotor}_current_A"] = torque / 0.01038
        columns[f"motor_{rotor}_voltage_V"] = 0.2 * torque / 0.01038 + omega / 96.342
        columns[f"motor_{rotor}_torque_N_m"] = torque
    return columns


def synthetic_flight(scenario, name):
    excess_J, sharpness, miss_m = FLIGHTS[name]
    frame = synthetic_frame(scenario, excess_J=excess_J, sharpness=sharpness)
    return SimpleNamespace(
        name=name,
        frame=frame,
        energy_J=float(frame["energy_J"].iloc[-1]),
        duration_s=scenario.mission.duration,
        terminal_miss_m=miss_m,
        terminal_miss={"rigid_body.x": miss_m},
        max_violation=0.0,
        worst_constraint="limits.thrust_limit",
        is_verified=True,
        wall_s=1.2345,
        owed_energy_J=0.0,
        broken_limits=(),
        resolves=(),
    )


def synthetic_history():
    sizes = ((10, 30, 2.4e-3), (14, 52, 7.7e-5), (19, 88, 3.1e-7))
    return tuple(
        MeshRecord(elements=e, points=p, iterations=19, objective=711.7, error=error, wall_s=0.2)
        for e, p, error in sizes
    )


def synthetic_costates(scenario, samples=90):
    time = np.linspace(0.0, scenario.mission.duration, samples)
    columns = {}
    for index, state in enumerate(STATES):
        columns[f"rigid_body.{state}"] = np.cos(time / 3 + index) / (1 + index)
    for rotor in range(1, 5):
        columns[f"rotors.omega[{rotor}]"] = 1e-3 * np.sin(time + rotor)
    columns["hamiltonian"] = 70.96 + 0 * time
    return pd.DataFrame(columns, index=pd.Index(time, name="time_s"))


def synthetic_verification(flight):
    return Verification(
        terminal_miss={f"rigid_body.{state}": 1e-7 * (1 + i) for i, state in enumerate(STATES)},
        terminal_miss_m=3e-7,
        worst_miss="rigid_body.r",
        max_violation=0.0,
        worst_constraint="limits.thrust_limit",
        energy_difference_J=2e-6,
        flown_energy_J=flight.energy_J + 2e-6,
        is_verified=True,
    )


def synthetic_failure():
    diagnosis = Diagnosis(
        residuals=(
            Residual(name="rigid_body.z_balance", element=4, time=0.8819, violation=3.6, unit="N"),
        ),
        active=(ActiveLimit(name="rotors.omega", limit=1047.197, unit="rad/s", share=0.62),),
        least_violation=0.2,
        relaxations=(),
        feasible_point=None,
    )
    return Failure(
        longest=NamedDuration("mission.duration", 2.0),
        shortest_duration_s=3.4,
        diagnosis=diagnosis,
        remedies=(),
    )


def synthetic_plan(
    scenario,
    flight,
    status=PlanStatus.VERIFIED,
    message="Optimal Solution Found.",
    failure=None,
):
    is_flown = status in (PlanStatus.VERIFIED, PlanStatus.SOLVED)
    known = flight.frame["time_s"].to_numpy()
    return SimpleNamespace(
        scenario=scenario,
        mission_flown=scenario,
        duration_s=flight.duration_s,
        energy=flight.energy_J,
        hover_energy_J=HOVER_ENERGY_J,
        status=status,
        message=message,
        is_verified=status is PlanStatus.VERIFIED,
        is_flyable=status in (PlanStatus.VERIFIED, PlanStatus.USABLE),
        figures_checked=FIGURES[scenario.solver.accuracy],
        accuracy_reached=scenario.solver.accuracy if status is PlanStatus.VERIFIED else None,
        energy_uncertainty=3.1e-7,
        risk=None,
        risk_words=PAPER_PLAN,
        save=lambda path: path.touch(),
        verification=synthetic_verification(flight) if is_flown else None,
        error_estimate=3.1e-7,
        history=synthetic_history(),
        iteration_count=57,
        attempts=(),
        routes=(),
        order_search=None,
        failure=failure,
        mesh=Mesh(breakpoints=(0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0), degrees=(6, 5, 4, 4, 5, 6)),
        flight=lambda name="optimal": SimpleNamespace(**(vars(flight) | {"name": name})),
        trajectories=SimpleNamespace(horizon=(known[0], known[-1])),
        times=lambda rate_hz=None: known[::10],
        columns=lambda times: {
            name: np.interp(times, known, column) for name, column in flight.frame.items()
        },
        to_frame=lambda rate_hz=None: flight.frame.iloc[::10].reset_index(drop=True),
        is_optimised=True,
        costate_frame=lambda: synthetic_costates(scenario),
    )


def synthetic_certificate():
    return SimpleNamespace(
        lower_bound_J=LOWER_BOUND_J,
        hover_energy_J=HOVER_ENERGY_J,
        applies=True,
        reason="the motor power is convex in thrust",
        is_of=lambda _duration_s: True,
        gap_percent=lambda energy_J: 100 * (energy_J - LOWER_BOUND_J) / energy_J,
    )


def with_tuned_autopilot(run, flight="adaptive/minimum_snap"):
    """Call one of the flights of a synthetic run that of a tuned autopilot."""
    settings = CruiseSettings(speed=8.38, acceleration=4.7, jerk=32.1)
    flown = next(one for one in run.flights if one.name == flight)
    flown.name = TUNED_CRUISE
    run.comparison.loc[run.comparison["flight"] == flight, "flight"] = TUNED_CRUISE
    tried = TriedCruise(
        settings=settings,
        reached=settings,
        duration_s=flown.duration_s,
        energy_J=flown.energy_J,
        arrived=True,
        broken=(),
        cost_J=flown.energy_J,
    )
    first = replace(
        tried,
        settings=CruiseSettings(speed=6.0, acceleration=3.0, jerk=4.0),
        reached=CruiseSettings(speed=5.2, acceleration=3.0, jerk=4.0),
        energy_J=1.1 * flown.energy_J,
        broken=("tilt",),
    )
    run.tuning = Tuning(flight=flown, settings=settings, tried=(first, tried))
    return run


def synthetic_run(path="scenarios/paper_wind.toml", overrides=(), flights=tuple(FLIGHTS)):
    """Return what a run of a scenario file looks like, without solving anything."""
    scenario = load_scenario(path, overrides)
    flown = tuple(synthetic_flight(scenario, name) for name in flights)
    certificate = synthetic_certificate()
    return SimpleNamespace(
        scenario=scenario,
        plan=synthetic_plan(scenario, flown[0]),
        flights=flown,
        comparison=compare_flights(scenario, flown, certificate, HOVER_ENERGY_J),
        certificate=certificate,
        adaptation=None,
        front=pd.DataFrame(),
        aims=pd.DataFrame(),
        timings={"solve": 1.0},
        warnings=(),
        tuning=None,
        often=None,
    )
