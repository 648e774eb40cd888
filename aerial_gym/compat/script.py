"""Scripts of the Aerial Gym Simulator without their ``isaacgym`` imports."""

import ast
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from aerial_gym.compat.stand_ins import stand_ins


def run_script(path: str | Path, arguments: Sequence[str] = ()) -> dict[str, Any]:
    """Run a script as ``python PATH ARGUMENTS`` would, without its ``isaacgym`` imports; return its global names.

    Modules that it imports may import ``isaacgym`` and ``gym`` themselves: ``stand_ins`` are lent to them.
    """
    path = Path(path)
    code = compile(without_isaacgym(path.read_text(encoding="utf-8")), str(path), "exec")
    script = ModuleType("__main__")
    script.__dict__.update(__file__=str(path), __builtins__=__builtins__)
    before = sys.modules["__main__"], sys.argv, sys.path
    sys.modules["__main__"], sys.argv = script, [str(path), *arguments]
    sys.path = [str(path.resolve().parent), *sys.path]
    try:
        with stand_ins():
            exec(code, script.__dict__)
    finally:
        sys.modules["__main__"], sys.argv, sys.path = before
    return script.__dict__


def without_isaacgym(source: str) -> str:
    """Return Python source without its ``isaacgym`` imports; line numbers stay."""
    lines = source.splitlines(keepends=True)
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, (ast.Import, ast.ImportFrom)) or not _imports_isaacgym(node):
            continue
        first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
        before, after = lines[first][: node.col_offset], lines[last][node.end_col_offset :]
        lines[first : last + 1] = [f"{before}{_import_without_isaacgym(node)}{after}", *["\n"] * (last - first)]
    return "".join(lines)


def _imports_isaacgym(node: ast.Import | ast.ImportFrom) -> bool:
    if isinstance(node, ast.ImportFrom):
        return node.level == 0 and _is_isaacgym(node.module or "")
    return any(_is_isaacgym(alias.name) for alias in node.names)


def _is_isaacgym(module: str) -> bool:
    return module.split(".")[0] == "isaacgym"


def _import_without_isaacgym(node: ast.Import | ast.ImportFrom) -> str:
    """Return an import statement without ``isaacgym``: the other modules of its line, or ``pass``."""
    remaining = [alias for alias in node.names if not _is_isaacgym(alias.name)] if isinstance(node, ast.Import) else []
    return ast.unparse(ast.Import(names=remaining)) if remaining else "pass"
