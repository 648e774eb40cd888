"""Optional packages: the extra that installs each, and the error for a missing one.

``pyproject.toml`` alone states the extras; they are read from the metadata of the installed package.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import util
from typing import TYPE_CHECKING

from aerial_gym.errors import MissingDependencyError

if TYPE_CHECKING:
    from packaging.requirements import Requirement

PROJECT = "aerial-gym"

MODULES = {
    "warp-lang": "warp", "pyyaml": "yaml", "pillow": "PIL", "rsl-rl-lib": "rsl_rl", "mkdocs-material": "material",
    "mkdocstrings-python": "mkdocstrings_handlers", "pytest-xdist": "xdist", "codespell": "codespell_lib",
}  # fmt: skip
"""Module by package, for packages whose module has another name."""


def module_name(package: str) -> str:
    """Return the name under which a package is imported."""
    return MODULES.get(package, package.replace("-", "_"))


@cache
def requirements() -> "dict[str, tuple[Requirement, ...]]":
    """Return the packages of each extra on this Python, those of the core under an empty name; empty if not installed."""
    from importlib import metadata  # takes a quarter of the time of --help

    from packaging.requirements import Requirement

    try:
        project = metadata.metadata(PROJECT)
    except metadata.PackageNotFoundError:
        return {}
    rows = [Requirement(text) for text in project.get_all("Requires-Dist") or ()]
    core = tuple(row for row in rows if row.marker is None or row.marker.evaluate({"extra": ""}))
    extras = {"": core}
    for name in project.get_all("Provides-Extra") or ():
        extras[name] = tuple(
            row for row in rows if row not in core and row.marker and row.marker.evaluate({"extra": name})
        )
    return extras


def extra_packages(extra: str) -> "tuple[Requirement, ...]":
    """Return the packages of an extra, and of the extras it contains; empty if it only joins others."""
    rows = requirements()[extra]
    own = tuple(row for row in rows if row.name != PROJECT)
    joined = sorted(name for row in rows if row.name == PROJECT for name in row.extras)
    return (*own, *(row for name in joined for row in extra_packages(name))) if own else ()


def find_extra(module: str) -> str | None:
    """Return the first extra that lists the package of a module; None if none does."""
    for name, packages in requirements().items():
        if name and any(module_name(package.name) == module for package in packages):
            return name
    return None


def missing_dependency(purpose: str, modules: list[str]) -> MissingDependencyError:
    """Return the error for modules that ``purpose`` needs, with the command that installs them."""
    extras = {module: find_extra(module) for module in modules}
    names = ",".join(dict.fromkeys(extra for extra in extras.values() if extra))
    unlisted = [module for module, extra in extras.items() if extra is None]
    install = " ".join([*([f"'{PROJECT}[{names}]'"] if names else []), *unlisted])
    return MissingDependencyError(f"{purpose} needs {' and '.join(modules)}: pip install {install}")


def require(purpose: str, *modules: str) -> None:
    """Raise ``MissingDependencyError`` with all modules that are not installed; import none of them."""
    missing = [module for module in modules if util.find_spec(module) is None]
    if missing:
        raise missing_dependency(purpose, missing)


@contextmanager
def optional_import(purpose: str) -> Iterator[None]:
    """Raise ``MissingDependencyError`` in place of the error of an import inside the block, if an extra has its package."""
    try:
        yield
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if find_extra(module) is None:
            raise
        raise missing_dependency(purpose, [module]) from None
