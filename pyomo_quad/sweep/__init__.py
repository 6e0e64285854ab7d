"""Parameter sweeps: solve many variants (cases) of one scenario and report the results.

A study file lists the scenario fields that vary and their values. Parallel workers, in processes
of this machine or on a Dask cluster, solve the cases. Each result is committed to an SQLite file
(the result store), so that an interrupted sweep can be resumed.
"""

from pyomo_quad.sweep.cluster import cluster_workers
from pyomo_quad.sweep.design import SweepDesign
from pyomo_quad.sweep.report import write_sweep_report
from pyomo_quad.sweep.runner import (
    SilentListener,
    Sweep,
    SweepEstimate,
    SweepListener,
    SweepSummary,
    estimate_sweep,
)
from pyomo_quad.sweep.store import ResultStore, StoreError, adopt_design, results_frame
from pyomo_quad.sweep.study_file import StudyError, design_sweep, load_study
from pyomo_quad.sweep.workers import ClusterError, Workers, process_workers

__all__ = [
    "ClusterError",
    "ResultStore",
    "SilentListener",
    "StoreError",
    "StudyError",
    "Sweep",
    "SweepDesign",
    "SweepEstimate",
    "SweepListener",
    "SweepSummary",
    "Workers",
    "adopt_design",
    "cluster_workers",
    "design_sweep",
    "estimate_sweep",
    "load_study",
    "process_workers",
    "results_frame",
    "write_sweep_report",
]
