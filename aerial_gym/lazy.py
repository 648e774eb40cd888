"""Lazy imports: names of a package load at first use, and their summaries are read from the source.

So ``aerial-gym list`` and ``--help`` need neither torch nor Warp.
"""

import ast
import gc
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any


def exports(package: str, path: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package with its imports under ``if TYPE_CHECKING:``.

    Type checkers and readers see ordinary imports; Python runs each at the first use of its name.

    Args:
        package: ``__name__`` of the package.
        path: ``__file__`` of its ``__init__.py``.
    """
    homes = _modules_of_names(ast.parse(Path(path).read_text(encoding="utf-8")))

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}. Known: {', '.join(sorted(homes))}")
        value = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return load, lambda: sorted({*vars(sys.modules[package]), *homes})


def _modules_of_names(tree: ast.Module) -> dict[str, str]:
    """Return the module of every name that is imported under ``if TYPE_CHECKING:``."""
    branches = (n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    imports = (n for branch in branches for n in branch.body if isinstance(n, ast.ImportFrom))
    return {alias.name: node.module or "" for node in imports for alias in node.names}


class _ImportHook(MetaPathFinder):
    """Calls a function once, when a module has been imported."""

    def __init__(self, module: str, call: Callable[[], object]) -> None:
        self._module, self._call = module, call

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return the ordinary spec of the module, with the call at the end of its import."""
        spec = PathFinder.find_spec(name, path, target) if name == self._module else None
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module = partial(self._execute, spec.loader.exec_module)
        return spec

    def _execute(self, execute: Callable[[ModuleType], None], module: ModuleType) -> None:
        execute(module)
        sys.meta_path.remove(self)
        self._call()


def call_after_import(module: str, call: Callable[[], object]) -> None:
    """Call a function when a module has been imported: now if it is, else at the end of its import."""
    if module in sys.modules:
        call()
    else:
        sys.meta_path.insert(0, _ImportHook(module, call))


@contextmanager
def pause_garbage_collection() -> Iterator[None]:
    """Pause garbage collection during imports, which saves a seventh of the time for torch and SciPy.

    The imported objects are also excluded from later collections.
    """
    looked = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if looked:
            gc.freeze()
            gc.enable()


@dataclass(frozen=True)
class ImportPath:
    """A class, function or other object of a module, by its path ``package.module:Name``."""

    place: str

    def load(self) -> Any:
        """Import the object."""
        module, _, name = self.place.partition(":")
        return getattr(import_module(module), name)

    def make(self) -> Any:
        """Import the class and call it."""
        return self.load()()

    def summary(self) -> str:
        """Return the ``summary`` in the body, or else the first line of the docstring, without an import."""
        module, _, name = self.place.partition(":")
        top, *inner = module.split(".")
        spec = find_spec(top)  # of the inner modules, it would import their packages
        if spec is None or not spec.submodule_search_locations:
            raise ModuleNotFoundError(f"no module {module!r}")
        file = Path(spec.submodule_search_locations[0]).joinpath(*inner)
        file = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
        tree = ast.parse(file.read_text(encoding="utf-8"))
        body = next(n for n in tree.body if isinstance(n, (ast.ClassDef, ast.FunctionDef)) and n.name == name)
        for node in body.body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "summary":
                return ast.literal_eval(node.value)
        return (ast.get_docstring(body) or "").partition("\n")[0]
