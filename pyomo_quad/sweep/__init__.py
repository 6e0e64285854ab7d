"""Sweeps: many cases of one scenario, on many workers, into a store that loses nothing."""

from pyomo_quad.sweep.design import SweepDesign
from pyomo_quad.sweep.report import write_sweep_report
from pyomo_quad.sweep.runner import (
    ClusterError,
    SilentListener,
    Sweep,
    SweepEstimate,
    SweepListener,
    SweepSummary,
    Workers,
    cluster_workers,
    estimate_sweep,
    process_workers,
)
from pyomo_quad.sweep.store import ResultStore, StoreError, adopt_design, results_frame
from pyomo_quad.sweep.study_file import StudyError, design_sweep, load_study

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
