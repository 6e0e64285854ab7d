"""The public API: the names listed in `public_api.txt`, and no others.

A name that goes away is deprecated first, as CHANGELOG.md says; one that is new is added to the
list, which `python -m tests.architecture.test_public_api` writes.
"""

from importlib import import_module
from inspect import isfunction
from pathlib import Path

LIST = Path(__file__).with_name("public_api.txt")
PACKAGES = (
    "pyomo_quad",
    "pyomo_quad.collocation",
    "pyomo_quad.exports",
    "pyomo_quad.flight",
    "pyomo_quad.model",
    "pyomo_quad.scenario",
    "pyomo_quad.sweep",
)


def public_names():
    return [f"{package} {name}" for package in PACKAGES for name in _names(package)]


def _names(package):
    return sorted(import_module(package).__all__)


def test_the_public_names_are_those_listed():
    listed = LIST.read_text(encoding="utf-8").splitlines()
    assert listed == public_names(), (
        "run python -m tests.architecture.test_public_api, see its text"
    )


def test_every_public_name_is_there_once_and_says_what_it_is():
    for package in PACKAGES:
        module = import_module(package)
        assert len(set(module.__all__)) == len(module.__all__)
        for name in module.__all__:
            held = getattr(module, name)
            is_told = isinstance(held, type) or isfunction(held)
            assert not is_told or (held.__doc__ or "").strip(), name


if __name__ == "__main__":
    LIST.write_text("".join(f"{line}\n" for line in public_names()), encoding="utf-8")
