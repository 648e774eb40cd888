"""Torch's global settings, device names and GPUs other than the first change nothing that the package computes."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest
import torch
from torch import Tensor

from aerial_gym import EnvManager, SimBuilder, Task, task_registry
from aerial_gym.errors import ConfigError
from aerial_gym.export import export_policy, load_exported
from aerial_gym.interop import record_graph, resolve_device, usual_settings
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.rl_training import evaluate, load_policy, train
from aerial_gym.rl_training.encoder.training import train_encoder
from aerial_gym.sensors import Imu, RayCaster
from aerial_gym.sensors.encoder.file import load_encoder
from tests.builders import simulation


@contextmanager
def default(kind: str, value: object, usual: object) -> Iterator[None]:
    getattr(torch, f"set_default_{kind}")(value)
    try:
        yield
    finally:
        getattr(torch, f"set_default_{kind}")(usual)


SETTINGS: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "float64": lambda: default("dtype", torch.float64, torch.float32),
    "bfloat16": lambda: default("dtype", torch.bfloat16, torch.float32),
    "meta": lambda: default("device", "meta", None),
    "inference mode": torch.inference_mode,
    "no gradients": torch.no_grad,
}


CHANGING = ("float64", "meta", "inference mode")  # Settings that change what torch makes, one of each kind


def test_settings_are_usual_inside_and_the_callers_elsewhere() -> None:
    @usual_settings
    def make_tensor() -> Tensor:
        return make_zeros()

    @usual_settings
    def make_zeros() -> Tensor:
        return torch.zeros(1)

    for name, setting in SETTINGS.items():
        with setting():
            before = torch.zeros(1)
            inner, after = make_tensor(), torch.zeros(1)
        assert (inner.dtype, inner.device.type, inner.is_inference()) == (torch.float32, "cpu", False), name
        assert (after.dtype, after.device, after.is_inference()) == (before.dtype, before.device, before.is_inference())
        assert not inner.requires_grad

    @usual_settings
    def fails() -> None:
        raise KeyError("lost")

    with SETTINGS["float64"](), pytest.raises(KeyError, match="lost"):
        fails()
    assert make_tensor().dtype is torch.float32


def fly(robot: str, controller: str, env: str, backend: str, device: str = "cpu") -> dict[str, Tensor]:
    sim = simulation(robot, controller, env=env, device=device, backend=backend)
    sim.reset()
    for _ in range(3):
        sim.step(torch.zeros(2, sim.robot_manager.num_actions, device="cpu"))
    sim.render()
    return {key: value.clone() for key, value in sim.gtd.items()}


CASES = [
    ("base_quadrotor_with_camera_imu", "lee_velocity_control", "env_with_obstacles", "warp"),
    ("base_quadrotor_in_gusts", "px4_position_control", "empty_env", "torch"),
]


@pytest.mark.parametrize("case", CASES)
def test_simulations_are_the_same_under_all_settings(case: tuple[str, str, str, str]) -> None:
    expected = fly(*case)
    for name in CHANGING:
        with SETTINGS[name]():
            result = fly(*case, "cpu:0")
        for key, value in expected.items():
            assert result[key].dtype is value.dtype, (name, key)
            assert torch.equal(result[key].nan_to_num(), value.nan_to_num()), (name, key)


@pytest.mark.parametrize("name", ["position_setpoint_task", "any_quadrotor_task"])
def test_tasks_are_the_same_under_all_settings(name: str) -> None:
    def observe(task: object, seed: int) -> Tensor:
        task.reset(seed=seed)
        for _ in range(3):
            result = task.step(torch.zeros(2, task.num_actions, device="cpu"))
        return result[0]["observations"].clone()

    expected = observe(task_registry.make_task(name, num_envs=2, device="cpu", seed=0), 5)
    for setting in CHANGING:
        with SETTINGS[setting]():
            task = task_registry.make_task(name, num_envs=2, device="cpu:0", seed=0)
            assert torch.equal(observe(task, 5), expected), setting
        assert torch.equal(observe(task, 5), expected), setting


def test_every_entry_point_takes_the_usual_settings() -> None:
    functions = (train, train_encoder, evaluate, load_policy, load_encoder, export_policy, load_exported)
    methods = (SimBuilder.build_env, EnvManager.step, Task.reset, Task.step, RayCaster.__init__, Imu.__init__)
    assert all(hasattr(one, "__wrapped__") for one in (*functions, *methods))


def test_names_of_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    assert resolve_device("cpu:0") == torch.device("cpu")
    assert GlobalTensorDictionary(sizes={}, device="cpu:0").device == torch.device("cpu")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert resolve_device("auto") == torch.device("cuda", 0)
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 2)
    assert resolve_device("cuda:3") == torch.device("cuda", 3)
    assert resolve_device("cuda") == torch.device("cuda", 2)
    assert resolve_device("auto") == torch.device("cuda", 2)
    with pytest.raises(ConfigError):
        resolve_device("cuda:4")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    with pytest.raises(ConfigError):
        resolve_device("cuda")


def test_a_graph_is_recorded_on_its_own_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fakes in place of GPUs: the second one is current, and so is a stream of it, while a graph records."""
    current: list[object] = [torch.device("cuda", 0)]

    @contextmanager
    def device(place: torch.device) -> Iterator[None]:
        current.append(place)
        yield
        current.pop()

    @contextmanager
    def graph(_: object, *, stream: torch.device, capture_error_mode: str) -> Iterator[None]:
        seen.append((current[-1], stream, capture_error_mode))
        yield

    seen: list[object] = []
    monkeypatch.setattr(torch.cuda, "device", device)
    monkeypatch.setattr(torch.cuda, "graph", graph)
    monkeypatch.setattr(torch.cuda, "Stream", lambda place: place)
    second = torch.device("cuda", 1)
    with record_graph(object(), second, errors="thread_local"):
        assert current[-1] == second
    assert (seen, current) == ([(second, second, "thread_local")], [torch.device("cuda", 0)])
