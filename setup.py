"""Carry the shipped scenarios, of which there is one copy, into the package when it is built."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithScenarios(build_py):
    """Builds the package with `scenarios/*.toml` and their winds and terrain in it."""

    def run(self) -> None:
        """Build, and add the scenarios."""
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib) / "pyomo_quad" / "shipped"
            target.mkdir(parents=True, exist_ok=True)
            for scenario in (Path(__file__).parent / "scenarios").glob("*.toml"):
                shutil.copy(scenario, target)
            for data in ("winds", "ridge"):
                source = Path(__file__).parent / "scenarios" / data
                shutil.copytree(source, target / data, dirs_exist_ok=True)


setup(cmdclass={"build_py": BuildWithScenarios})
