"""What a backend lacks is refused by its name, with one that has it. Effects sorted by kind."""

import sys
from dataclasses import replace

import pytest
import torch

from aerial_gym.errors import CapabilityError, MissingDependencyError, UnknownNameError
from aerial_gym.physics import BACKENDS, EFFECTS, TorchBackend, WarpBackend
from aerial_gym.physics.capabilities import Needs, choose_backend, require, robot_needs
from aerial_gym.physics.effects import EffectsByKind, LoadEffect, WindEffect, WrenchEffect
from tests.builders import simulation
from tests.physics.rotor_types import three_type_robot
from tests.unit.task.hover import begin

CPU = torch.device("cpu")
LACKS = {"rotors": (), "contact": False, "effects": (), "integrators": ("euler",), "joints": False}


class Plain(WarpBackend):
    capabilities = replace(WarpBackend().capabilities, **LACKS)


ALL = "'warp', 'torch', 'mujoco', 'mujoco_warp'"
GPU, META = torch.device("cuda"), torch.device("meta")


@pytest.mark.parametrize(("needs", "message"), [
    ({"device": META}, r"cannot run on meta \(devices: cpu, cuda\). No registered backend can"),
    ({"dtype": torch.float64}, r"cannot compute in torch.float64 .*. Use backend 'torch'"),
    ({"integrator": "rk4"}, r"cannot run integrator 'rk4' \(integrators: euler\). Use backend 'warp', 'torch'.$"),
    ({"effects": ("rotor_drag",)}, f"cannot run effect 'rotor_drag'. Use backend {ALL}"),
    ({"rotors": frozenset({"reversible"})}, f"cannot run reversible rotors. Use backend {ALL}"),
    ({"rotors": frozenset({"force"})}, r"cannot run rotors in force mode"),
    ({"rotors": frozenset({"slew"})}, r"cannot run rotors with a slew rate"),
    ({"contact": True}, r"cannot push back at a contact. Use backend 'warp', 'torch', 'mujoco'"),
    ({"gradients": True}, r"cannot pass gradients through a step. Use backend 'torch'"),
    ({"joints": True}, r"cannot move joints. Use backend 'warp', 'torch', 'mujoco'"),
])  # fmt: skip
def test_a_lack_is_refused_by_name_with_the_way_out(needs: dict[str, object], message: str) -> None:
    with pytest.raises(CapabilityError, match=f"backend plain: {message}"):
        require(Plain(), Needs(**{"device": CPU} | needs), name="plain")


@pytest.mark.parametrize(("needs", "message"), [
    ({"device": GPU}, r"cannot run on cuda \(devices: cpu\). Use backend 'warp', 'torch'.$"),
    ({"integrator": "rk4"}, r"cannot run integrator 'rk4' \(integrators: euler\). Use backend 'warp'"),
    ({"gradients": True}, r"cannot pass gradients through a step. Use backend 'torch'.$"),
])  # fmt: skip
def test_what_mujoco_cannot_is_refused_by_name(needs: dict[str, object], message: str) -> None:
    with pytest.raises(CapabilityError, match=f"backend mujoco: {message}"):
        choose_backend("mujoco", needs=Needs(**{"device": CPU} | needs))


def test_a_backend_that_is_not_installed_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    told = r"backend 'mujoco' needs mujoco: pip install 'aerial-gym\[mujoco\]'"
    with pytest.raises(MissingDependencyError, match=told):
        simulation("base_quadrotor", backend="mujoco")


def test_both_backends_run_rotors_of_any_kind() -> None:
    needs = robot_needs(three_type_robot(), CPU, contact=True)
    for name in ("torch", "warp"):
        require(BACKENDS.get(name)(), needs, name=name)


def test_auto_takes_warp_unless_gradients_or_another_float_type_are_requested() -> None:
    assert isinstance(choose_backend("auto", needs=Needs(device=CPU)), WarpBackend)
    assert isinstance(choose_backend("auto", needs=Needs(device=CPU, gradients=True)), TorchBackend)
    assert isinstance(choose_backend("auto", needs=Needs(device=CPU, dtype=torch.float64)), TorchBackend)


def test_a_simulation_and_a_task_run_on_the_backend_that_is_named() -> None:
    for options, kind in (({"backend": "torch"}, TorchBackend), ({}, WarpBackend)):
        assert isinstance(simulation("base_quadrotor", "lee_attitude_control", **options).robot_manager.backend, kind)
    with begin("position_setpoint_task", 2, backend="torch") as task:
        assert isinstance(task.env.robot_manager.backend, TorchBackend)
        task.step(torch.zeros(2, 4))
    with pytest.raises(UnknownNameError, match="physics backend 'wrap'.*Did you mean 'warp'"):
        simulation("base_quadrotor", "lee_attitude_control", backend="wrap")


def some() -> EffectsByKind:
    """Return a load, a drag, a wind and another drag, in this order, each with parameters of its number."""
    names = ("slung_payload", "rotor_drag", "constant_wind", "quadratic_drag")
    return EffectsByKind((EFFECTS.get(name), torch.full((2, 3), float(i))) for i, name in enumerate(names))


def effect_names(effects: EffectsByKind) -> list[str]:
    return [effect.name for effect, _ in effects]


def test_effects_of_a_kind_keep_their_order() -> None:
    effects = some()
    assert [effect.name for effect, _ in effects[WrenchEffect]] == ["rotor_drag", "quadratic_drag"]
    assert [effect.name for effect, _ in effects[WindEffect]] == ["constant_wind"]
    assert EffectsByKind()[WindEffect] == ()


def test_forces_come_by_kind_and_the_load_last() -> None:
    forces = some().step_effects
    assert [effect.name for effect, _ in forces] == ["constant_wind", "rotor_drag", "quadratic_drag", "slung_payload"]
    assert [float(params[0, 0]) for _, params in forces] == [2.0, 1.0, 3.0, 0.0]
    assert LoadEffect.order == max(effect.order or 0 for effect in map(EFFECTS.get, EFFECTS))
    assert some().names_with_memory == ("slung_payload",)


def test_changes_make_others() -> None:
    effects = some()
    assert effect_names(effects.exclude(LoadEffect)) == ["rotor_drag", "constant_wind", "quadratic_drag"]
    assert effect_names(effects.with_effect(EFFECTS.get("gusts"), torch.zeros(2, 2)))[-1] == "gusts"
    doubled = effects.with_params(lambda effect, params: params * (2.0 if isinstance(effect, WindEffect) else 1.0))
    assert [float(params[0, 0]) for _, params in doubled] == [0.0, 1.0, 4.0, 3.0]
    assert effect_names(effects) == effect_names(doubled)


def test_places_follow_one_another_without_a_gap() -> None:
    names = ("battery_sag", "joint_spring", "constant_wind")
    effects = EffectsByKind((EFFECTS.get(name), torch.zeros(2, len(EFFECTS.get(name).parameters))) for name in names)
    places = effects.places(num_rotors=5)
    assert [place.effect.name for place in places] == ["constant_wind", "joint_spring", "battery_sag"]
    assert [place.params for place in places] == [slice(0, 3), slice(3, 6), slice(6, 7)]
    assert [place.memory for place in places] == [slice(0, 0), slice(0, 5), slice(5, 7)]
