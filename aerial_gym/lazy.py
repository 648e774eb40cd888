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

from aerial_gym.extras import optional_import


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
        with optional_import(f"{package}.{name}"):
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

    def file(self) -> Path:
        """Return the file of the module, or of ``package:file.yaml``, without an import of the module."""
        module, _, name = self.place.partition(":")
        top, *inner = module.split(".")
        spec = find_spec(top)  # of the inner modules, it would import their packages
        paths = [Path(spec.origin)] if spec is not None and spec.origin is not None and not inner else []
        for root in spec.submodule_search_locations or () if spec is not None else ():
            folder = Path(root).joinpath(*inner)
            own = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
            paths.insert(0, folder / name if name.endswith((".yaml", ".yml")) else own)
        for path in paths:
            if path.is_file():
                return path
        raise ModuleNotFoundError(f"no file {name!r} in {module!r}" if "." in name else f"no module {module!r}")

    def summary(self) -> str:
        """Return one line about the object without an import; empty if its source does not state it.

        This is the ``summary`` in the body of a class or in the call that makes the object, else the first line of a docstring.
        """
        module, _, name = self.place.partition(":")
        source = self.file().read_text(encoding="utf-8")
        for node in ast.parse(source).body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name == name:
                given = [_assignment_value(statement, "summary") for statement in node.body]
                return _first_text(given) or (ast.get_docstring(node) or "").partition("\n")[0]
            if isinstance(call := _assignment_value(node, name), ast.Call):
                return _first_text([each.value for each in call.keywords if each.arg == "summary"])
        if name not in source:
            raise AttributeError(f"module {module!r} has no {name!r}")
        return ""


def _assignment_value(node: ast.stmt, name: str) -> ast.expr | None:
    """Return the value that a statement assigns to a name; None of another statement."""
    return node.value if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name else None


def _first_text(nodes: Sequence[ast.expr | None]) -> str:
    """Return the first of the nodes that is a text; empty without one."""
    return next((n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)), "")
