"""Study files and designs made by tests."""

from pathlib import Path

from pyomo_quad.sweep.case import StudyTask
from pyomo_quad.sweep.design import Dimension, SweepDesign

SCENARIO = """
name = "base"
title = "Base case"
[mission]
duration = 10.0
goal.position = [6.0, 7.0, 8.0]
[wind]
coupling = "acceleration"
"""

DURATION_AXIS = """
[[axis]]
path = "mission.duration"
linear = { first = 4.0, last = 13.0, count = 10 }
"""

PAYLOAD_AXIS = """
[[axis]]
path = "vehicle.payload"
linear = { first = 0.0, last = 0.2, count = 5 }
"""


def write_study(folder: Path, axes: str = DURATION_AXIS + PAYLOAD_AXIS, head: str = "") -> Path:
    (folder / "base.toml").write_text(SCENARIO)
    study = folder / "study.toml"
    study.write_text(f'name = "study"\ntitle = "A study"\nscenario = "base.toml"\n{head}\n{axes}')
    return study


def made_design(*dimensions: Dimension, base=(), report_on: str = "energy_J") -> SweepDesign:
    return SweepDesign(
        name="grid",
        title="",
        about="",
        task=StudyTask.OPTIMISE,
        baselines=(),
        outputs=(),
        report_on=(report_on,),
        base=dict(base),
        dimensions=dimensions,
    )
