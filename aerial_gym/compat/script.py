"""Scripts of the Aerial Gym Simulator without their ``isaacgym`` imports."""

import ast
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import gymnasium

from aerial_gym.compat.modules import copy_names


class Wrapper(gymnasium.Env):
    """``gym.Wrapper``: an environment around another one, whose attributes are its own unless it has them itself."""

    def __init__(self, env: Any) -> None:
        self.env = env

    def __getattr__(self, name: str) -> Any:
        if name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)

    def reset(self, **kwargs: Any) -> Any:
        """Reset the environment inside, with the arguments given and no others."""
        return self.env.reset(**kwargs)

    def step(self, action: Any) -> Any:
        """Step the environment inside."""
        return self.env.step(action)


def _gym_modules() -> dict[str, ModuleType]:
    """Return the replacements of ``gym`` and ``gym.spaces``, built from Gymnasium."""
    gym = ModuleType("gym")
    gym.__dict__.update({**vars(gymnasium), "__name__": "gym", "Wrapper": Wrapper})
    return {"gym": gym, "gym.spaces": gymnasium.spaces}


class IsaacGymLoader(Loader):
    """Fills a module of ``isaacgym``."""

    def exec_module(self, module: ModuleType) -> None:
        """Fill the module with its functions; other names raise an error with the remedy."""
        if module.__name__ == "isaacgym.torch_utils":
            copy_names("math", module)
            return

        def raise_missing(name: str) -> NoReturn:
            raise AttributeError(
                f"{module.__name__}.{name}: there is no Isaac Gym here. What scripts ask it for is in global_tensor_dict; see "
                "docs/guides/coming_from_aerial_gym.md"
            )

        module.__dict__.update(__getattr__=raise_missing, __all__=[])


class IsaacGymFinder(MetaPathFinder):
    """Finds ``isaacgym`` and whatever is imported from it."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of a stand-in, None for any other module."""
        if fullname.partition(".")[0] != "isaacgym":
            return None
        return spec_from_loader(fullname, IsaacGymLoader(), is_package=True)


@contextmanager
def stand_ins() -> Iterator[None]:
    """Make ``isaacgym`` and ``gym`` importable within the block if they are not installed."""
    finder = IsaacGymFinder()
    temporary: dict[str, Any] = {} if find_spec("gym") else _gym_modules()
    sys.meta_path.append(finder)
    sys.modules.update(temporary)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in [*temporary, *(name for name in sys.modules if name.partition(".")[0] == "isaacgym")]:
            if name in temporary or isinstance(getattr(sys.modules[name], "__loader__", None), IsaacGymLoader):
                del sys.modules[name]


def run_script(path: str | Path, arguments: Sequence[str] = ()) -> dict[str, Any]:
    """Run a script as ``python PATH ARGUMENTS`` would, without its ``isaacgym`` imports; return its global names. Modules that
    it imports may import ``isaacgym`` and ``gym`` themselves: ``stand_ins`` are lent to them."""
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
        if not isinstance(node, (ast.Import, ast.ImportFrom)):
            continue
        remaining = [alias for alias in node.names if not _is_isaacgym(alias.name)]
        matches = len(remaining) < len(node.names)
        if isinstance(node, ast.ImportFrom):
            remaining, matches = [], node.level == 0 and _is_isaacgym(node.module or "")
        if not matches:
            continue
        statement = ast.unparse(ast.Import(names=remaining)) if remaining else "pass"
        first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
        before, after = lines[first][: node.col_offset], lines[last][node.end_col_offset :]
        lines[first : last + 1] = [f"{before}{statement}{after}", *["\n"] * (last - first)]
    return "".join(lines)


def _is_isaacgym(module: str) -> bool:
    return module.split(".")[0] == "isaacgym"
