"""What a package offers, without importing it: names load when first used, and one line about each is read from its source.

``aerial-gym list`` and ``--help`` answer so without torch and Warp.
"""

import ast
import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def exports(package: str, path: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package whose imports stand under ``if TYPE_CHECKING:``.

    Type checkers and readers see ordinary imports; Python runs each of them when its name is first used.

    Args:
        package: ``__name__`` of the package.
        path: ``__file__`` of its ``__init__.py``.
    """
    homes = _homes(ast.parse(Path(path).read_text(encoding="utf-8")))

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}. Known: {', '.join(sorted(homes))}")
        value = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return load, lambda: sorted({*vars(sys.modules[package]), *homes})


def _homes(tree: ast.Module) -> dict[str, str]:
    """Return the module of every name that is imported under ``if TYPE_CHECKING:``."""
    branches = (n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    imports = (n for branch in branches for n in branch.body if isinstance(n, ast.ImportFrom))
    return {alias.name: node.module or "" for node in imports for alias in node.names}


@contextmanager
def no_garbage() -> Iterator[None]:
    """Import inside without looking for garbage, of which modules make none: a seventh of the time of torch and SciPy.

    What they hold is looked through no more later on either.
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
class Home:
    """A class, or what else a module holds, by its place ``package.module:Name``."""

    place: str

    def load(self) -> Any:
        """Import it."""
        module, _, name = self.place.partition(":")
        return getattr(import_module(module), name)

    def make(self) -> Any:
        """Import the class and call it."""
        return self.load()()

    def summary(self) -> str:
        """Return the ``summary`` in the class's body, or else the first line of its docstring, without importing it."""
        module, _, name = self.place.partition(":")
        spec = find_spec(module)
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(f"no module {module!r}")
        tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
        body = next(n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name)
        for node in body.body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "summary":
                return ast.literal_eval(node.value)
        return (ast.get_docstring(body) or "").partition("\n")[0]
