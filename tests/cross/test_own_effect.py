"""An effect in a user's own package, in torch only: both backends fly it, and the closed loop finds it in flights."""

import sys
from importlib import import_module
from pathlib import Path

import pytest
import torch

from aerial_gym.control import CONTROLLERS
from aerial_gym.errors import CapabilityError
from aerial_gym.physics.warp_backend import WarpBackend
from tests.cross.test_backends import assert_same_flight, build
from tests.physics.vehicles import asymmetric_robot
from tests.unit.sim2real.flat_flights import ROBOT, flight, verdict_of_command

PACKAGE = '''
"""Drag with the third power of the speed."""

import torch

from aerial_gym import EFFECTS
from aerial_gym.physics.effects import LinearWrenchEffect, Parameter


class CubicDrag(LinearWrenchEffect):
    """``F = -c |v|² v``."""

    name = "cubic_drag"
    summary = "drag with the third power of the speed"
    parameters = (Parameter(name="c", unit="N s³/m³", low=0.0, high=10.0, scale=0.05, meaning="drag coefficient"),)
    excitation = "several speeds"
    confused_with = ("rotor_drag", "quadratic_drag")
    follows = ("velocity",)

    def regressor(self, condition):
        v = condition.air_velocity
        force = -(v * v).sum(-1, keepdim=True) * v
        return torch.cat((force, torch.zeros_like(force)), dim=-1).unsqueeze(-1)


EFFECTS.register("cubic_drag", CubicDrag())
'''


@pytest.fixture
def own_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_registries: None) -> str:
    """Return the name of an effect that a package outside ``aerial_gym`` has registered."""
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "my_effects.py").write_text(PACKAGE)
    monkeypatch.delitem(sys.modules, "my_effects", raising=False)
    import_module("my_effects")
    return "cubic_drag"


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_backends_agree_on_a_user_effect(own_effect: str, integrator: str) -> None:
    assert_same_flight(asymmetric_robot(), CONTROLLERS.get("no_control"), integrator, effects=(own_effect,))


def test_closed_loop_finds_a_user_effect(own_effect: str, tmp_path: Path) -> None:
    tables = [flight(60 + seed, cubic=0.05, seconds=6.0, rate=100.0, noise=1.0) for seed in range(3)]
    verdict = verdict_of_command(tmp_path, ROBOT, tables, "--effects", own_effect, "rotor_drag", "quadratic_drag")
    (effect,) = verdict["effects"]
    assert effect["name"] == own_effect
    low, high = effect["interval"]["c"]
    assert low < 0.05 < high


REFUSED = {
    "if v[:, 0] > 0.0: v = -v": "a branch on a value",
    "if v[0, 0] > 0.0: v = -v": "mixes rows",
    "v = v * v.argmax(-1, keepdim=True)": "argmax",
    "v[:, 2] = 0.0": "writes in place",
    "v = v.cumsum(-1)": "cumsum is not a supported operation",
}


@pytest.mark.parametrize("line", REFUSED)
def test_code_that_no_kernel_can_run_is_refused_with_its_place(
    own_effect: str, line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The message names the effect, the cause, file and line, and the remedy."""
    (tmp_path / "bad_effects.py").write_text(
        PACKAGE.replace("v = condition.air_velocity", f"v = condition.air_velocity * 1.0\n        {line}").replace(
            "cubic_drag", "bad_drag"
        )
    )
    monkeypatch.delitem(sys.modules, "bad_effects", raising=False)
    import_module("bad_effects")

    model, law = build(asymmetric_robot(), CONTROLLERS.get("no_control"), 2, torch.float32, effects=("bad_drag",))
    with pytest.raises(CapabilityError, match=rf"bad_drag: .*{REFUSED[line]}.*bad_effects\.py:\d+ .*torch\.where"):
        WarpBackend().allocate(model, law, integrator="euler")
