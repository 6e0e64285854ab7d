"""A model builder of the user's own, named in a scenario as ``file.py:function``."""

from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from pyomo.core import ConcreteModel

from pyomo_quad.model.build import build_model
from pyomo_quad.scenario import Scenario, ScenarioError

Builder = Callable[[Scenario], ConcreteModel]


def model_builder(scenario: Scenario, *, is_code_allowed: bool) -> Builder:
    """Return what builds the scenario's model: `build_model` or the user's own function.

    Parameters
    ----------
    scenario : Scenario
        Its field ``model`` may name a builder, relative to the scenario's folder.
    is_code_allowed : bool
        Whether the user agreed to run code from a file.

    Returns
    -------
    callable
        Takes a scenario, returns a ConcreteModel.

    Raises
    ------
    ScenarioError
        If the scenario names a builder and code is not allowed, or it cannot be loaded.
    """
    if scenario.model is None:
        return build_model
    if not is_code_allowed:
        raise ScenarioError(
            f"model = {scenario.model!r} runs code from a file; allow it with --allow-code."
        )
    return load_builder(scenario.model, scenario.folder)


def load_builder(spec: str, base_folder: Path) -> Builder:
    """Load a model builder from a Python file.

    Parameters
    ----------
    spec : str
        ``file.py:function``.
    base_folder : Path
        Where a relative file name starts.

    Returns
    -------
    callable
        Takes a scenario, returns a ConcreteModel.

    Raises
    ------
    ScenarioError
        If there is no such file or function, the file does not run, or, when called, the
        function returns something else.
    """
    file_name, _, function_name = spec.rpartition(":")
    module = _run(spec, base_folder / file_name)
    function = getattr(module, function_name, None)
    if not callable(function):
        raise ScenarioError(
            f"model = {spec!r}: {file_name} has no function {function_name}; it must define "
            f"{function_name}(scenario)."
        )

    def build(scenario: Scenario) -> ConcreteModel:
        try:
            model = function(scenario)
        except Exception as error:
            raise ScenarioError(
                f"model = {spec!r}: {function_name} fails: {_told(error)}; correct it."
            ) from error
        if not isinstance(model, ConcreteModel):
            raise ScenarioError(
                f"model = {spec!r} returned {type(model).__name__}; it must return a ConcreteModel."
            )
        return model

    return build


def _run(spec: str, file: Path) -> ModuleType:
    if not file.is_file():
        raise ScenarioError(f"model = {spec!r}: no file {file}; name an existing Python file.")
    module_spec = spec_from_file_location(f"custom_model_{file.stem}", file)
    if module_spec is None or module_spec.loader is None:
        raise ScenarioError(f"model = {spec!r}: {file} is not Python; name a file ending in .py.")
    module = module_from_spec(module_spec)
    try:
        module_spec.loader.exec_module(module)
    except Exception as error:
        raise ScenarioError(
            f"model = {spec!r}: {file} does not run: {_told(error)}; correct it."
        ) from error
    return module


def _told(error: Exception) -> str:
    return ": ".join((type(error).__name__, *str(error).splitlines()[:1]))
