"""A case solver of a few milliseconds, which tells whether it was given the right warm start.

Its numbers hang on the whole line of ancestors of a case: a wrong, missing or additional warm
start anywhere changes them.  Faults are injected through the environment, which workers inherit.
"""

import hashlib
import json
import os
import signal
import time
from pathlib import Path

from pyomo_quad.sweep.case import CaseResult, CaseTask

SOLVER = "tests.sweep.stand_in:solve_case"
# Seconds that a case takes, file that lists the cases solved, payload that kills its worker.
SECONDS = "STAND_IN_SECONDS"
LOG = "STAND_IN_LOG"
FATAL_PAYLOAD = "STAND_IN_FATAL_PAYLOAD"
IMPOSSIBLE_DURATION = 3.0


def solve_case(task: CaseTask) -> CaseResult:
    scenario = json.loads(task.scenario)
    time.sleep(float(os.environ.get(SECONDS, "0")))
    payload = scenario["vehicle"]["payload"]
    duration = scenario["mission"]["duration"]
    if os.environ.get(FATAL_PAYLOAD) == repr(payload):
        os.kill(os.getpid(), signal.SIGKILL)
    if duration < IMPOSSIBLE_DURATION:
        raise ValueError(f"{duration} s is too short")
    lineage = hashlib.sha256((task.warm_start or b"") + task.key.encode()).digest()
    if LOG in os.environ:
        with Path(os.environ[LOG]).open("a") as log:
            log.write(f"{task.key}\n")
    wind = scenario["wind"]
    power = 70.0 * (1.3 + payload) ** 1.5 + 3.0 * wind["speed"] ** 2
    energy = power * duration + 4000.0 / duration**2
    return CaseResult(
        values={
            "energy_J": energy,
            "hover_energy_J": 70.0 * 1.3**1.5 * duration,
            "lineage": float(int.from_bytes(lineage[:6])),
        },
        warm_start=lineage,
    )
