"""The direction of imports: a package imports itself and what stands further left, nothing else."""

import ast
import subprocess
import sys
from functools import cache
from importlib import import_module
from inspect import ismodule
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent / "aerial_gym"
GROUPS = (
    ("lazy", "errors"),
    ("interop", "math"),
    ("config", "registry"),
    ("physics", "assets"),
    ("control", "sensors"),
    ("robots",),
    ("env_manager",),
    ("task",),
    ("rl_training", "sim2real", "viewer", "benchmarks"),
    ("compat", "export"),
    ("cli",),
)
RANK = {name: rank for rank, group in enumerate(GROUPS) for name in group}


ROOMS = (
    ("arrays",),
    ("plain", "progress", "statistics", "memory"),
    ("logs",),
    ("predict",),
    ("identify",),
    ("failures",),
    ("judge",),
    ("report",),
    ("replay", "teststand"),
    ("in_memory",),
    ("close_loop",),
)
"""Of ``sim2real``: flights come in on the left, pages go out on the right; the loop is last, as joints are found on the test
stand."""
ROOM_RANK = {name: rank for rank, group in enumerate(ROOMS) for name in group}


@cache
def nodes_of(path: Path) -> list[ast.Import | ast.ImportFrom | ast.Call]:
    """Return the imports of a file and its launches of kernels; each file is read once for all tests."""

    def asked_for(node: ast.AST) -> bool:
        launches = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in LAUNCHES
        return launches or isinstance(node, ast.Import | ast.ImportFrom)

    return [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if asked_for(node)]  # type: ignore[misc]


LAUNCHES = ("launch", "launch_tiled")


def imports_of(path: Path, package: str = "aerial_gym") -> set[str]:
    """Return the first-level packages and modules of a package that a file imports."""
    found = set()
    for node in nodes_of(path):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
            if node.module == package:
                names = [f"{package}.{alias.name}" for alias in node.names]
        found |= {name.removeprefix(f"{package}.").split(".")[0] for name in names if name.startswith(f"{package}.")}
    return found


LONGEST = 400
"""Lines of a file of ``sim2real``."""


def test_no_file_of_the_loop_is_too_long_to_read() -> None:
    lines = {
        path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / "sim2real").rglob("*.py")
    }
    assert {name: count for name, count in lines.items() if count > LONGEST} == {}


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.py")), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_left(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0].removesuffix(".py")
    if package == "__init__":
        return
    for other in imports_of(path) - {package}:
        if other in RANK:
            assert RANK[other] < RANK[package], f"{package} must not import {other}"


SIM2REAL = ROOT / "sim2real"


@pytest.mark.parametrize("path", sorted(SIM2REAL.rglob("*.py")), ids=lambda p: str(p.relative_to(SIM2REAL)))
def test_rooms_of_sim2real_import_left(path: Path) -> None:
    room = path.relative_to(SIM2REAL).parts[0].removesuffix(".py")
    if room == "__init__":
        return
    for other in imports_of(path, "aerial_gym.sim2real") - {room}:
        assert ROOM_RANK[other] < ROOM_RANK[room], f"{room} must not import {other}"


UNIT = ROOT.parent / "tests" / "unit"


@pytest.mark.parametrize("path", sorted(UNIT.rglob("test_*.py")), ids=lambda p: str(p.relative_to(UNIT)))
def test_unit_tests_mirror_the_package(path: Path) -> None:
    """``tests/unit/<package>/test_<module>.py``; those of ``benchmarks/`` stand in a folder of that name."""
    folder = path.parent.relative_to(UNIT)
    if not folder.parts:
        assert (ROOT / path.name.removeprefix("test_")).exists(), f"{path.name} belongs into the folder of its package"
    assert (ROOT / folder).is_dir() or (ROOT.parent / folder).is_dir(), f"no package {folder}"
    assert (path.parent / "__init__.py").exists()


def test_undeclared_plant_shares_no_code_with_the_package() -> None:
    for path in (ROOT.parent / "benchmarks" / "undeclared").glob("*.py"):
        assert "aerial_gym" not in {n.split(".")[0] for n in _all_imports(path)}, path


def _all_imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


@pytest.mark.parametrize(
    "command",
    [
        "import aerial_gym",
        "import aerial_gym.cli.main as m; m.main(['--help'])",
        "import aerial_gym.cli.main as m; m.main(['list'])",
    ],
)
def test_what_only_tells_imports_nothing_heavy(command: str) -> None:
    """No torch, no Warp, no optional dependency: importing the package, ``--help`` and ``list`` answer at once."""
    heavy = ("torch", "warp", "numpy", "tyro", "rich", "pandas", "rl_games")
    code = f"import sys; {command}; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.splitlines()[-1] == "[]"


def test_a_plain_vehicle_imports_nothing_that_it_does_not_have() -> None:
    code = (
        "import sys; from aerial_gym.task import task_registry; "
        "task_registry.make_task('position_setpoint_task', num_envs=2, device='cpu'); print(*sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    unneeded = (
        "assets.clearance", "assets.collision", "assets.geometry", "assets.motion", "assets.track",
        "control.betaflight", "control.cascade", "control.crazyflie", "control.px4",
        "physics.articulated", "physics.effects.blade_element", "robots.joints.links", "robots.scene_contact",
        "sensors.imu", "sensors.ray_caster",
    )  # fmt: skip
    assert [name for name in unneeded if f"aerial_gym.{name}" in out.stdout.split()] == []


def test_every_name_of_a_package_is_there() -> None:
    """Names that load when first used are in ``__all__``, are what ``dir`` says, and can be loaded."""
    for init in sorted(ROOT.rglob("__init__.py")):
        package = import_module(".".join(init.parent.relative_to(ROOT.parent).parts))
        for name in getattr(package, "__all__", ()):
            assert name in dir(package), (package.__name__, name)
            if (init.parent / f"{name}.py").exists():
                import_module(f"{package.__name__}.{name}")
                assert not ismodule(getattr(package, name)), f"{package.__name__}.{name} is the module"
            getattr(package, name)


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.py")), ids=lambda p: str(p.relative_to(ROOT)))
def test_every_launch_says_where(path: Path) -> None:
    """Without a device Warp takes the first GPU there is, and reads what lies elsewhere."""
    for node in nodes_of(path):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in {f"wp.{name}" for name in LAUNCHES}:
            assert "device" in {keyword.arg for keyword in node.keywords}, f"{path}:{node.lineno}"
