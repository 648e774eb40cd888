"""The command line: what it prints, and exit status 2 with one sentence for a wrong request."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from aerial_gym import __version__
from aerial_gym.cli.main import COMMANDS, RENAMED
from aerial_gym.config import CONFIG_DIR
from aerial_gym.control import CONTROL_LAWS
from aerial_gym.control.laws import LAWS
from aerial_gym.env_manager import SIMS
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS, ROTOR_MAPS, effects
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from tests.integration.commands import run


def test_overview_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "--help")
    assert status == 0
    for name in COMMANDS:
        assert f"\n  {name} " in out
    status, out, _ = run(capsys, "--version")
    assert (status, out) == (0, f"aerial-gym {__version__}\n")


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_explains_its_options(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, *name.split(), "--help")
    assert status == 0
    assert "usage" in out.lower()


def test_list_as_json_holds_every_kind(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "list", "--json")
    assert status == 0
    result = json.loads(out)
    kinds = "sims environments robots controllers control-laws sensors imus effects rotor-maps backends tasks trainers"
    assert {*kinds.split(), "log-formats", "pretrained"} == set(result)
    assert set(result["imus"]) == {"base_imu", "bmi088", "vn100"} < set(result["sensors"])
    assert result["controllers"]["no_control"] == "thrust of each rotor [N]"
    assert "base_sim_headless" in result["sims"]
    assert SIMS.get("base_sim_headless").dt == SIMS.get("base_sim").dt
    assert {*EFFECTS.names(), "learned_residual"} == set(result["effects"])
    assert {*LAWS, *CONTROL_LAWS, "thrust", "rotor_speed"} == set(result["control-laws"])
    assert list(ROTOR_MAPS) == list(result["rotor-maps"])


def test_every_configuration_of_the_package_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    result = json.loads(run(capsys, "list", "--json")[1])
    for kind in ("sims", "environments", "robots", "sensors", "imus", "tasks"):
        assert {path.stem for path in (CONFIG_DIR / kind).rglob("*.yaml")} <= set(result[kind]), kind
    for module in (Path(effects.__file__).parent).glob("*.py"):
        classes = [n for n in ast.parse(module.read_text(encoding="utf-8")).body if isinstance(n, ast.ClassDef)]
        names = {ast.literal_eval(v) for c in classes if (v := _class_value(c, "name")) is not None}
        assert names <= set(result["effects"]), module


def _class_value(body: ast.ClassDef, name: str) -> ast.expr | None:
    """Return the value that a class body gives to a name."""
    given = (n for n in body.body if isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == name)
    return next((n.value for n in given), None)


def test_nothing_is_said_where_nobody_listens() -> None:
    """As with ``aerial-gym list --json | head -1``."""
    command = [sys.executable, "-c", "from aerial_gym.cli.main import entry; entry()", "list", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == (b"", 1)


def test_list_of_one_kind_is_a_table_with_units_intact(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "list", "controllers")
    assert status == 0
    assert "lee_position_control" in out
    assert "[m]" in out


@pytest.mark.parametrize(("kind", "name"), [
    ("observation-terms", "position_error_world"),
    ("reward-terms", "distance_bell"),
    ("termination-terms", "contact"),
    ("task-buffers", "previous_distance"),
    ("commands", "drawn_point"),
    ("actions", "forward_flight"),
])  # fmt: skip
def test_parts_of_tasks_are_listed_with_a_line_each(kind: str, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "list", kind, "--json")
    assert status == 0
    result = json.loads(out)[kind]
    assert name in result
    assert all(len(line) > 10 and "`" not in line for line in result.values())


LOGS = ("--train", "a.csv", "--test", "b.csv", "--out", "never")


@pytest.mark.parametrize(("argv", "message"), [
    (("lst",), "no command 'lst'. Known: list, robot import, robot check, robot tune, robot from-log"),
    (("list", "robts"), "no kind 'robts'. Known: sims"),
    (("list", "--jsn"), "--json"),
    (("train", "--task", "position_setpoint_tsk"), "'position_setpoint_tsk'. Did you mean 'position_setpoint_task'"),
    (("train", "--device", "tpu9"), "device 'tpu9': must be auto, cpu, cuda"),
    (("evaluate", "--policy", "nowhere"), "nowhere"),
    (("replay", "tinyprp", "flight.csv"), "no robot 'tinyprp'. Did you mean 'tinyprop'"),
    (("replay", "tinyprop", "flight.csv"), "flight.csv: no such file"),
    (("robot", "check", "."), "."),
    (("robot", "import", "nowhere.urdf", "--out", "o.yaml"), "nowhere.urdf"),
    (("close-loop", "--robot", "missing.yaml", *LOGS), "missing.yaml: no such file"),
    (("bench", "physics", "--controller", "lee_position_contrl"), "Did you mean 'lee_position_control'?"),
    (("bench", "physics", "--integrator", "rk5"), "no integrator 'rk5'. Known: euler, rk4"),
    (("bench", "physics", "--num-envs", "0"), "--num-envs = 0: must be at least 1"),
    (("bench", "physics", "--threads", "0"), "--threads = 0: must be at least 1"),
    (("bench", "physics", "--dt-s", "0"), "--dt-s = 0.0: must be > 0"),
    (("bench", "physics", "--repeat-time-s", "nan"), "--repeat-time-s = nan: must be > 0"),
    (("bench", "task", "--repeats", "0"), "--repeats = 0: must be at least 1"),
])  # fmt: skip
def test_wrong_requests_end_with_status_2_and_one_sentence(argv, message, capsys) -> None:
    status, out, err = run(capsys, *argv)
    assert (status, out) == (2, "")
    assert message in err
    assert "Traceback" not in err


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_a_renamed_command_warns_and_runs(old: str, new: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, old, "--help")
    assert status == 0
    assert new in err
    assert f"usage: aerial-gym {new}" in out


@pytest.mark.parametrize(("argv", "expected"), [(("robot",), 2), (("robot", "fly"), 2), (("robot", "--help"), 0)])
def test_a_noun_lists_its_verbs(argv: tuple[str, ...], expected: int, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, *argv)
    assert status == expected
    assert all(f"robot {verb}" in (err if expected else out) for verb in ("import", "check", "tune"))


def test_what_is_material_reaches_the_loop(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    given = []

    def record_criteria(*_: object, criteria: Criteria, **__: object) -> None:
        given.append(criteria)
        raise ConfigError("seen")

    monkeypatch.setattr("aerial_gym.sim2real.close_loop", record_criteria)
    call = ("close-loop", "--robot", "tinyprop", *LOGS)
    for more, material in ((("--material", "0.2"), 0.2), ((), Criteria().material)):
        assert (run(capsys, *call, *more)[0], given[-1]) == (2, Criteria(material=material))
