"""The direction of imports: a package imports itself and what stands further left, nothing else."""

import ast
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from inspect import ismodule
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent / "aerial_gym"
ORDER = (
    "errors | extras | lazy | interop math | config registry | physics assets | control sensors | robots | env_manager | "
    "task | rl_training sim2real | export compat | for_real firmware fleet viewer workloads | cli | __main__"
)
"""The only statement of the import order. A package may still be absent, but no package may be missing here."""

GROUPS = [group.split() for group in ORDER.split("|")]
RANK = {name: rank for rank, group in enumerate(GROUPS) for name in group}


ROOMS = (
    ("arrays", "findings"),
    ("json_values", "progress", "statistics", "memory"),
    ("logs",),
    ("predict",),
    ("identify",),
    ("failures",),
    ("judge",),
    ("wording",),
    ("report",),
    ("flight_evidence", "flight_replay", "teststand"),
    ("preflight",),
    ("loop",),
)
"""The only statement of the import order within ``sim2real``. Each folder may import the folders above it."""
ROOM_RANK = {name: rank for rank, group in enumerate(ROOMS) for name in group}


LAUNCHES = ("launch", "launch_tiled")
FILES = sorted(ROOT.rglob("*.py"))


@cache
def import_and_launch_nodes(path: Path) -> list[ast.Import | ast.ImportFrom | ast.Call]:
    """Return the imports of a file and its launches of kernels; each file is read once for all tests."""

    def matches(node: ast.AST) -> bool:
        launch = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in LAUNCHES
        return launch or isinstance(node, ast.Import | ast.ImportFrom)

    return [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if matches(node)]  # type: ignore[misc]


def module_imports(path: Path) -> set[str]:
    """Return the full names of the modules that a file imports; of ``from package import name`` both package and name."""
    modules: set[str] = set()
    for node in import_and_launch_nodes(path):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return modules


def wrong_imports(folder: Path, ranks: dict[str, int]) -> list[str]:
    """Return the files of a package that import a part of it which does not stand further left. A module of the same
    group, such as ``errors.py``, may be imported by the packages of its group."""
    package = ".".join(folder.relative_to(ROOT.parent).parts)
    offences = []
    for path in sorted(folder.rglob("*.py")):
        part = path.relative_to(folder).parts[0].removesuffix(".py")
        names = {name.removeprefix(f"{package}.") for name in module_imports(path) if name.startswith(f"{package}.")}
        for other in {name.split(".")[0] for name in names} & ranks.keys() - {part}:
            module_of_group = ranks[other] == ranks.get(part) and (folder / f"{other}.py").exists()
            if part != "__init__" and ranks[other] >= ranks[part] and not module_of_group:
                offences.append(f"{path.relative_to(ROOT)}: {part} must not import {other}")
    return offences


LONGEST = 400
"""Lines of a file of ``sim2real``."""


def test_no_file_of_the_loop_is_too_long_to_read() -> None:
    lines = {
        path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / "sim2real").rglob("*.py")
    }
    assert {name: count for name, count in lines.items() if count > LONGEST} == {}


def test_imports_point_left() -> None:
    assert wrong_imports(ROOT, RANK) == []


def test_contributing_has_one_row_for_each_package_in_the_import_order() -> None:
    """Rows of the table read ``| `aerial_gym/NAME/` | purpose |``."""
    text = (ROOT.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `aerial_gym/(\w+)(?:/|\.py)` \| (.+) \|$", text, re.MULTILINE)
    names = {path.stem for path in ROOT.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert {name for name, _ in rows} == names - {"__init__"} == names & set(RANK)
    assert [name for name, _ in rows] == [name for group in GROUPS for name in group if name in names]
    assert all(purpose.strip() for _, purpose in rows)


def test_rooms_of_sim2real_import_left() -> None:
    rooms = {
        path.relative_to(ROOT / "sim2real").parts[0].removesuffix(".py") for path in FILES if "sim2real" in path.parts
    }
    assert rooms - {"__init__"} == ROOM_RANK.keys()
    assert wrong_imports(ROOT / "sim2real", ROOM_RANK) == []


def test_effects_import_nothing_from_the_fused_kernel() -> None:
    """Effects are pure torch functions, from which the kernel is traced."""
    files = sorted((ROOT / "physics" / "effects").rglob("*.py"))
    kernels = ("warp", "aerial_gym.physics.fused", "aerial_gym.math.warp_functions")
    assert [path.name for path in files if any(name.startswith(kernels) for name in module_imports(path))] == []


def test_unit_tests_mirror_the_package() -> None:
    """``tests/unit/<package>/test_<module>.py``; those of ``benchmarks/`` stand in a folder of that name."""
    unit = ROOT.parent / "tests" / "unit"

    def mirrors(path: Path) -> bool:
        folder = path.parent.relative_to(unit)
        if not folder.parts:
            return (ROOT / path.name.removeprefix("test_")).exists()
        return ((ROOT / folder).is_dir() or (ROOT.parent / folder).is_dir()) and (path.parent / "__init__.py").exists()

    assert [str(path.relative_to(unit)) for path in sorted(unit.rglob("test_*.py")) if not mirrors(path)] == []


def test_undeclared_plant_shares_no_code_with_the_package() -> None:
    files = sorted((ROOT.parent / "benchmarks" / "undeclared").glob("*.py"))
    files += [ROOT.parent / "benchmarks" / "preflight" / name for name in ("faults.py", "flights.py")]
    files += [ROOT.parent / "benchmarks" / "fleet" / "flights.py"]
    assert [path.name for path in files if "aerial_gym" in {name.split(".")[0] for name in module_imports(path)}] == []


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


def test_the_loop_imports_no_distributions() -> None:
    """``scipy.stats`` takes longer to import than a flight takes to read."""
    code = "import sys, aerial_gym.sim2real.loop; sys.exit('scipy.stats' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_plain_vehicle_imports_nothing_that_it_does_not_have() -> None:
    """Its kernels are not compiled."""
    code = (
        "import sys; from unittest.mock import Mock; from aerial_gym.interop import launches; launches._workers = Mock();"
        "from aerial_gym.task import task_registry; "
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


def test_every_launch_says_where() -> None:
    """Without a device Warp takes the first GPU there is, and reads what lies elsewhere."""
    offences = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in FILES
        for node in import_and_launch_nodes(path)
        if isinstance(node, ast.Call) and ast.unparse(node.func) in {f"wp.{name}" for name in LAUNCHES}
        if "device" not in {keyword.arg for keyword in node.keywords}
    ]
    assert offences == []
