"""Plug-ins of other packages: names from metadata, code at first use, faults in one line each."""

import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from aerial_gym.cli.main import main
from aerial_gym.control import CONTROL_LAWS, CONTROLLERS
from aerial_gym.errors import DuplicateNameError, UnknownNameError
from aerial_gym.physics import BACKENDS, EFFECTS
from aerial_gym.registry import plugins
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import IMUS, SENSORS
from aerial_gym.task import BUFFERS, COMMANDS, REWARDS
from tests.conftest import REGISTRIES
from tests.refusals import assert_refused

Install = Callable[..., Path]

CABLE = '''
import torch
from aerial_gym.physics.effects import LinearWrenchEffect, Parameter


class CableWeight(LinearWrenchEffect):
    """A cable."""

    name = "cable_weight"
    summary = "weight of a cable"
    parameters = (Parameter(name="w", unit="N", low=0.0, high=10.0, scale=0.1, meaning="weight"),)
    excitation = "thrust"
    confused_with = ("payload_mass",)

    def regressor(self, condition):
        force = -condition.up
        return torch.cat((force, torch.zeros_like(force)), dim=-1).unsqueeze(-1)
'''
POINT = {"effect.cable_weight": "cable:CableWeight"}


def test_an_effect_is_known_by_metadata_and_imported_at_its_first_use(install: Install) -> None:
    install("my-lab", POINT, cable=CABLE)
    assert "cable_weight" in EFFECTS
    assert EFFECTS.summaries()["cable_weight"] == "weight of a cable"
    assert EFFECTS.packages() == {"cable_weight": "my-lab"}
    assert "cable" not in sys.modules
    assert EFFECTS.get("cable_weight").parameters[0].name == "w"
    assert plugins.plugin_versions["my-lab"] == "1.0"
    assert list(EFFECTS)[-1] == "cable_weight"  # after those of this package


def test_the_list_imports_neither_torch_nor_the_package(install: Install) -> None:
    folder = install("my-lab", POINT, cable=CABLE)
    code = (
        "import sys, aerial_gym.cli.main as m; status = m.main(['list', 'effects', '--json']); "
        "print([n for n in ('torch', 'cable') if n in sys.modules], status)"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(folder), os.getcwd()))}
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert out.stdout.splitlines()[-1] == "[] 0"
    table = json.loads(out.stdout.rpartition("}")[0] + "}")
    assert table["effects"]["cable_weight"] == "weight of a cable"
    assert table["packages"] == {"effects": {"cable_weight": "my-lab"}}
    help_code = (
        "import sys, aerial_gym.cli.main as m; m.main(['--help']); "
        "print([n for n in sys.modules if n.startswith('importlib.metadata')])"
    )
    out = subprocess.run([sys.executable, "-c", help_code], capture_output=True, text=True, check=True, env=environment)
    assert out.stdout.splitlines()[-1] == "[]"
    assert "--no-plugins" in out.stdout


def test_the_list_says_the_package_of_a_name(install: Install, capsys: pytest.CaptureFixture[str]) -> None:
    install("my-lab", POINT, cable=CABLE)
    assert main(["list", "effects"]) == 0
    assert "cable_weight            weight of a cable (package my-lab)\n" in capsys.readouterr().out


def test_a_flag_and_a_variable_turn_plug_ins_off(
    install: Install, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(plugins.SWITCH, "0")
    install("my-lab", POINT, cable=CABLE)
    assert main(["list", "--no-plugins", "effects"]) == 0
    assert os.environ[plugins.SWITCH] == "1"
    assert "cable_weight" not in capsys.readouterr().out
    assert "cable_weight" not in EFFECTS


BROKEN = {
    "no kind": (
        {"effects.a": "cable:A"},
        "effects.a = 'cable:A': no kind 'effects'. Did you mean 'effect'? Known: action",
    ),
    "no name": ({"effect": "cable:A"}, "effect = 'cable:A': the name must be KIND.NAME, such as effect.my_effect"),
    "no object": ({"effect.a": "cable"}, "effect.a = 'cable': must be module:object or package:file.yaml"),
    "own name": ({"effect.rotor_drag": "cable:A"}, "the name is taken by package aerial-gym. Choose another one"),
    "no module": ({"effect.a": "nowhere:A"}, "effect 'a' (nowhere:A): ModuleNotFoundError: no module 'nowhere'"),
    "no class": ({"effect.a": "cable:Cabel"}, "AttributeError: module 'cable' has no 'Cabel'"),
    "no file": ({"robot.a": "lab:a.yaml"}, "robot 'a' (lab:a.yaml): ModuleNotFoundError: no file 'a.yaml' in 'lab'"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_fault_of_the_metadata_is_one_line_and_leaves_the_rest(
    install: Install, fault: str, caplog: pytest.LogCaptureFixture
) -> None:
    points, message = BROKEN[fault]
    (install("my-lab", POINT | points, cable=CABLE) / "lab").mkdir()
    with caplog.at_level(logging.WARNING):
        assert EFFECTS.summaries()["cable_weight"] == "weight of a cable"
        assert "a" not in EFFECTS.summaries()
        assert "a" not in ROBOTS.summaries()
    (line,) = caplog.messages
    assert line.startswith("plug-in package my-lab 1.0: ")
    assert message in line
    assert "\n" not in line
    assert line.endswith(". It is left out")


def test_unreadable_metadata_is_one_line(install: Install, caplog: pytest.LogCaptureFixture) -> None:
    folder = install("my-lab", POINT, cable=CABLE)
    install("bad-lab", {})
    (folder / "bad_lab-1.0.dist-info" / "entry_points.txt").write_text(f"[{plugins.GROUP}]\nno value\n")
    nameless = folder / "lost-1.0.dist-info"
    nameless.mkdir()
    (nameless / "entry_points.txt").write_text(f"[{plugins.GROUP}]\neffects.a = x:A\n")
    assert EFFECTS.packages() == {"cable_weight": "my-lab"}
    assert [line.split(":")[0] for line in caplog.messages] == [
        "plug-in package bad-lab 1.0", "plug-in package lost-1.0.dist-info None",
    ]  # fmt: skip


def test_two_packages_with_one_name_are_both_named(install: Install, caplog: pytest.LogCaptureFixture) -> None:
    install("a-lab", POINT, cable=CABLE)
    install("b-lab", POINT)
    assert EFFECTS.packages() == {"cable_weight": "a-lab"}
    assert (
        "plug-in package b-lab 1.0: effect 'cable_weight' (cable:CableWeight): the name is taken by package a-lab"
        in (caplog.text)
    )
    assert_refused(DuplicateNameError, "registered already by package a-lab", EFFECTS.register, "cable_weight", None)


FAILING = {
    "an import": ("import no_such_library\n", "ModuleNotFoundError: No module named 'no_such_library'"),
    "an exit": ("raise SystemExit(3)\n", "SystemExit: 3"),
    "no effect": ("class A: pass\n", "<class 'failing.A'> is no Effect"),
    "another name": (CABLE.replace("CableWeight", "A"), "its name is 'cable_weight'. Give both the same name"),
}


@pytest.mark.parametrize("fault", FAILING)
def test_code_that_fails_is_left_out_and_breaks_nothing(
    install: Install, fault: str, caplog: pytest.LogCaptureFixture
) -> None:
    source, message = FAILING[fault]
    install("my-lab", {"effect.a": "failing:A"} | POINT, failing=f"{source}\nA = 'A' in vars() and A\n", cable=CABLE)
    assert "a" in EFFECTS.names()
    with pytest.raises(UnknownNameError) as refusal:
        EFFECTS.get("a")
    assert message in str(refusal.value)
    assert str(refusal.value).startswith("plug-in package my-lab 1.0: effect 'a' (failing:A): ")
    assert not caplog.messages
    assert [name for name in EFFECTS if name in ("a", "cable_weight")] == ["cable_weight"]  # all entries are needed
    assert caplog.messages == [str(refusal.value)]
    assert "a" not in EFFECTS
    list(EFFECTS)
    assert len(caplog.messages) == 1


def test_a_module_may_register_its_own_part(install: Install) -> None:
    """So one file serves as a script and as a plug-in."""
    reward = (
        "from aerial_gym.task import REWARDS\n\n\n@REWARDS.term(command=('thrust',))\n"
        "def smooth(robot_linvel):\n    '''Return 1.'''\n    return robot_linvel[:, 0]\n"
    )
    buffer = (
        "from aerial_gym.task import BUFFERS\n\n\n@BUFFERS.buffer(shape=(3,), unit='m')\n"
        "def place(robot_position):\n    '''Return the place.'''\n    return robot_position.clone()\n"
    )
    install("my-lab", {"reward.smooth": "smooth:smooth", "buffer.place": "place:place"}, smooth=reward, place=buffer)
    assert REWARDS.summaries()["smooth"] == "Return 1."
    assert REWARDS.get("smooth").command == ("thrust",)
    assert REWARDS.packages() == {"smooth": "my-lab"}
    assert BUFFERS.get("place").unit == "m"


def test_a_module_imported_before_the_plug_ins_are_looked_for_is_no_second_owner(
    install: Install, caplog: pytest.LogCaptureFixture
) -> None:
    register = "\nfrom aerial_gym import EFFECTS\nEFFECTS.register('cable_weight', CableWeight())\n"
    install("my-lab", POINT, cable=CABLE + register)
    __import__("cable")
    assert EFFECTS.packages() == {"cable_weight": "my-lab"}
    assert not caplog.messages


def test_functions_become_terms_and_a_law_is_a_controller(install: Install) -> None:
    term = "def smooth(robot_linvel, *, width: float):\n    '''Return 1.'''\n    return robot_linvel[:, 0]\n"
    law = "class Climb:\n    '''Climb rate.'''\n\n    action_names = ('vz',)\n"
    points = {"reward.smooth": "parts:smooth", "control_law.climb": "parts:Climb", "command.bad": "parts:Climb"}
    install("my-lab", points, parts=term + law)
    assert REWARDS.get("smooth").reads == ("robot_linvel",)
    assert CONTROL_LAWS.get("climb").__name__ == "Climb"
    assert (CONTROLLERS.get("climb").law, CONTROLLERS.summaries()["climb"]) == ("climb", "Climb rate.")
    assert_refused(UnknownNameError, "command 'bad' .*Climb'> is no class derived from Command", COMMANDS.get, "bad")


def test_configuration_files_are_parts(install: Install, caplog: pytest.LogCaptureFixture) -> None:
    points = {"robot.wide": "lab.robots:wide.yaml", "imu.bad": "lab:bad.yaml", "backend.b": "lab:wide.yaml"}
    folder = install("my-lab", points)
    (folder / "lab" / "robots").mkdir(parents=True)
    file = folder / "lab" / "robots" / "wide.yaml"
    file.write_text("summary: a wide one\nextends: base_quadrotor\n", encoding="utf-8")
    (folder / "lab" / "bad.yaml").write_text("model: [\n", encoding="utf-8")
    (folder / "lab" / "wide.yaml").write_text("summary: no class\n", encoding="utf-8")
    assert ROBOTS.summaries()["wide"] == "a wide one"
    assert ROBOTS.get("wide").body == ROBOTS.get("base_quadrotor").body
    assert "bad" not in IMUS.summaries()
    assert "imu 'bad' (lab:bad.yaml): " in caplog.text
    assert_refused(
        UnknownNameError, "wide.yaml: entries of this kind are no files. Give module:object", BACKENDS.get, "b"
    )
    assert "wide" not in SENSORS


def test_every_kind_is_accepted_by_one_registry() -> None:
    kinds = [kind for registry in REGISTRIES for kind in registry._plugin_kinds]
    assert sorted({*kinds}) == sorted(plugins.KINDS)
    assert sorted(kinds) == sorted((*plugins.KINDS, "control_law"))  # also a controller
