"""Sweeps: many cases of one scenario, on many workers, into a store that loses nothing."""

from pyomo_quad.study.sweep.design import SweepDesign
from pyomo_quad.study.sweep.errors import ClusterError, StoreError, StudyError
from pyomo_quad.study.sweep.estimate import SweepEstimate, estimate_sweep
from pyomo_quad.study.sweep.planning import design_sweep
from pyomo_quad.study.sweep.results import results_frame
from pyomo_quad.study.sweep.resuming import adopt_design
from pyomo_quad.study.sweep.runner import SilentListener, Sweep, SweepListener, SweepSummary
from pyomo_quad.study.sweep.store import ResultStore
from pyomo_quad.study.sweep.study_file import load_study
from pyomo_quad.study.sweep.workers import Workers, cluster_workers, process_workers

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
]
