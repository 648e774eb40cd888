"""What a backend lacks is refused by its name, with one that has it."""

import sys
from dataclasses import replace

import pytest
import torch

from aerial_gym import SimBuilder, task_registry
from aerial_gym.errors import CapabilityError, MissingDependencyError, UnknownNameError
from aerial_gym.physics import BACKENDS, TorchBackend, WarpBackend
from aerial_gym.physics.capabilities import Needs, choose_backend, require, robot_needs
from tests.physics.rotor_types import three_type_robot

CPU = torch.device("cpu")


class Plain(WarpBackend):
    """A backend that knows nothing but plain rotors that are held by nothing."""

    capabilities = replace(
        WarpBackend().capabilities, rotors=(), contact=False, effects=(), integrators=("euler",), joints=False
    )


@pytest.mark.parametrize(
    ("needs", "message"),
    [
        (Needs(device=torch.device("meta")), r"cannot run on meta \(devices: cpu, cuda\). No registered backend can"),
        (Needs(device=CPU, dtype=torch.float64), r"cannot compute in torch.float64 .*. Use backend 'torch'"),
        (
            Needs(device=CPU, integrator="rk4"),
            r"cannot run integrator 'rk4' \(integrators: euler\). Use backend 'warp', 'torch'.$",
        ),
        (
            Needs(device=CPU, effects=("rotor_drag",)),
            r"cannot run effect 'rotor_drag'. Use backend 'warp', 'torch', 'mujoco', 'mujoco_warp'",
        ),
        (
            Needs(device=CPU, rotors=frozenset({"reversible"})),
            r"cannot run reversible rotors. Use backend 'warp', 'torch', 'mujoco', 'mujoco_warp'",
        ),
        (Needs(device=CPU, rotors=frozenset({"force"})), r"cannot run rotors in force mode"),
        (Needs(device=CPU, rotors=frozenset({"slew"})), r"cannot run rotors with a slew rate"),
        (Needs(device=CPU, contact=True), r"cannot push back at a contact. Use backend 'warp', 'torch', 'mujoco'"),
        (Needs(device=CPU, gradients=True), r"cannot pass gradients through a step. Use backend 'torch'"),
        (Needs(device=CPU, joints=True), r"cannot move joints. Use backend 'warp', 'torch', 'mujoco'"),
    ],
)
def test_a_lack_is_refused_by_name_with_the_way_out(needs: Needs, message: str) -> None:
    with pytest.raises(CapabilityError, match=f"backend plain: {message}"):
        require(Plain(), needs, name="plain")


@pytest.mark.parametrize(
    ("needs", "message"),
    [
        (Needs(device=torch.device("cuda")), r"cannot run on cuda \(devices: cpu\). Use backend 'warp', 'torch'.$"),
        (
            Needs(device=CPU, integrator="rk4"),
            r"cannot run integrator 'rk4' \(integrators: euler\). Use backend 'warp'",
        ),
        (Needs(device=CPU, gradients=True), r"cannot pass gradients through a step. Use backend 'torch'.$"),
    ],
)
def test_what_mujoco_cannot_is_refused_by_name(needs: Needs, message: str) -> None:
    with pytest.raises(CapabilityError, match=f"backend mujoco: {message}"):
        choose_backend("mujoco", needs=needs)


def test_a_backend_that_is_not_installed_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    names = {"sim_name": "base_sim", "env_name": "empty_env", "robot_name": "base_quadrotor"}
    with pytest.raises(
        MissingDependencyError, match=r"backend 'mujoco' needs mujoco: pip install 'aerial-gym\[mujoco\]'"
    ):
        SimBuilder().build_env(**names, controller_name="no_control", num_envs=1, device="cpu", backend="mujoco")


def test_both_backends_run_rotors_of_any_kind() -> None:
    needs = robot_needs(three_type_robot(), CPU, contact=True)
    for name in ("torch", "warp"):
        require(BACKENDS.get(name)(), needs, name=name)


def test_auto_takes_warp_unless_gradients_or_another_float_type_are_requested() -> None:
    assert isinstance(choose_backend("auto", needs=Needs(device=CPU)), WarpBackend)
    assert isinstance(choose_backend("auto", needs=Needs(device=CPU, gradients=True)), TorchBackend)
    assert isinstance(choose_backend("auto", needs=Needs(device=CPU, dtype=torch.float64)), TorchBackend)


def test_a_simulation_and_a_task_run_on_the_backend_that_is_named() -> None:
    names = {"sim_name": "base_sim", "env_name": "empty_env", "robot_name": "base_quadrotor"}
    build = {**names, "controller_name": "lee_attitude_control", "num_envs": 2, "device": "cpu"}
    assert isinstance(SimBuilder().build_env(**build, backend="torch").robot_manager.backend, TorchBackend)
    assert isinstance(SimBuilder().build_env(**build).robot_manager.backend, WarpBackend)
    with task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", backend="torch") as task:
        assert isinstance(task.env.robot_manager.backend, TorchBackend)
        task.reset()
        task.step(torch.zeros(2, 4))
    with pytest.raises(UnknownNameError, match="physics backend 'wrap'.*Did you mean 'warp'"):
        SimBuilder().build_env(**build, backend="wrap")
