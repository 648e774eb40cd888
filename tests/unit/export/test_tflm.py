"""Models for PX4's ``mc_nn_control``: the bytes, the action of the module, and policies that it cannot fly.

``tests/slow/test_tflm_engine.py`` runs the models in TensorFlow Lite Micro."""

import struct
from copy import deepcopy
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.errors import ConfigError
from aerial_gym.export.export import write_policy
from aerial_gym.export.layout import Layout
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.targets import tflm
from aerial_gym.export.targets.requirements import engine_inputs, input_places
from aerial_gym.rl_training import Policy
from tests.engines.policies import engine_layout
from tests.unit.export.policies import random_policy

TERMS = ("lin_vel_world", "position_error_world", "ang_vel_body", "rotation_rows")  # not in the order of the module


def relu_policy(normalize: bool = True) -> tuple[Policy, Layout]:
    policy = random_policy(15, activation="relu", normalize=normalize)
    policy.head.weight.data *= 0.05
    return policy, engine_layout(policy, TERMS, robot="x500", scale=0.5)


class Reader:
    """Reads a flatbuffer by the public encoding: offsets, tables with a list of slots, vectors."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def number(self, form: str, place: int) -> int:
        return struct.unpack_from(f"<{form}", self.data, place)[0]

    def follow(self, place: int) -> int:
        return place + self.number("I", place)

    def field(self, table: int, slot: int) -> int:
        """Return the place of a field; 0 if it has its default."""
        slots = table - self.number("i", table)
        offset = self.number("H", slots + 4 + 2 * slot) if 4 + 2 * slot < self.number("H", slots) else 0
        return table + offset if offset else 0

    def scalar(self, table: int, slot: int, form: str) -> int:
        place = self.field(table, slot)
        return self.number(form, place) if place else 0

    def vector(self, table: int, slot: int) -> tuple[int, int]:
        """Return place and length."""
        place = self.follow(self.field(table, slot))
        return place + 4, self.number("I", place)

    def tables(self, table: int, slot: int) -> list[int]:
        place, count = self.vector(table, slot)
        return [self.follow(place + 4 * i) for i in range(count)]

    def integers(self, table: int, slot: int) -> tuple[int, ...]:
        place, count = self.vector(table, slot)
        return struct.unpack_from(f"<{count}i", self.data, place)


def run_model(data: bytes, inputs: np.ndarray) -> np.ndarray:
    """Return the outputs of a model of dense layers, read by ``Reader`` and computed in float64."""
    read = Reader(data)
    assert data[4:8] == b"TFL3"
    model = read.follow(0)
    assert read.scalar(model, 0, "I") == 3
    (code,), (graph,), buffers = read.tables(model, 1), read.tables(model, 2), read.tables(model, 4)
    assert (read.scalar(code, 0, "b"), read.scalar(code, 3, "i"), read.scalar(code, 2, "i")) == (9, 9, 1)
    tensors, values = read.tables(graph, 0), {}
    for number, tensor in enumerate(tensors):
        assert read.scalar(tensor, 1, "b") == 0, "float32"
        if buffer := read.scalar(tensor, 2, "I"):
            place, length = read.vector(buffers[buffer], 0)
            assert place % 16 == 0, "alignment of the schema"
            content = np.frombuffer(data[place : place + length], "<f4").reshape(read.integers(tensor, 0))
            values[number] = content.astype(np.float64)
    values[read.integers(graph, 1)[0]] = inputs
    for operator in read.tables(graph, 3):
        source, weight, bias = read.integers(operator, 1)
        assert (read.scalar(operator, 0, "I"), read.scalar(operator, 3, "B")) == (0, 8)
        result = values[source] @ values[weight].T + values[bias]
        options = read.follow(read.field(operator, 4))
        (target,) = read.integers(operator, 2)
        assert read.integers(tensors[target], 0) == (1, result.shape[1])
        values[target] = np.maximum(result, 0.0) if read.scalar(options, 0, "b") == 1 else result
    return values[read.integers(graph, 2)[0]]


@pytest.mark.parametrize("normalize", [True, False])
def test_the_model_has_the_thrusts_of_the_policy(normalize: bool, tmp_path: Path) -> None:
    """The module's actions, in its order of inputs and motors, are thrusts of the policy over the unit, less one."""
    policy, made = relu_policy(normalize)
    flown = DeployablePolicy(deepcopy(policy), made).double().eval()
    data = tflm.files(DeployablePolicy(policy, made).eval(), made)["hover.tflite"]
    seen = 6.0 * torch.randn(2_000, 15, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    thrust, _ = flown(seen)
    assert ((thrust > 0.0) & (thrust < 20.0)).double().mean() > 0.3
    given = np.concatenate(
        [seen.numpy()[:, part] for part in (slice(3, 6), slice(9, 15), slice(0, 3), slice(6, 9))], axis=1
    )
    actions = run_model(data, given)
    motors = thrust[:, [0, 1, 2, 3]].numpy()  # x500 lists its rotors in the order of PX4
    np.testing.assert_allclose(actions, motors / tflm.thrust_unit(made) - 1.0, atol=2e-6)
    command, _ = tflm.commands(made, torch.from_numpy(actions))
    torch.testing.assert_close(command, thrust, atol=1e-4, rtol=0.0)
    assert torch.equal(engine_inputs(seen, *input_places(made, tflm.INPUTS), 15), torch.from_numpy(given))


@pytest.mark.parametrize("robot", ["x500", "crazyflie_21_brushless"])
def test_rotors_turn_as_the_thrust_asks(robot: str) -> None:
    """``mc_nn_control`` computes ``rpm = 60 sqrt((action + 1) / (1e-5 coefficient))``; that speed gives the thrust of the
    policy by the vehicle's quadratic curve, and the parameter is within its range."""
    policy = random_policy(15, activation="relu")
    made = engine_layout(policy, TERMS, robot=robot)
    rotor, numbers = made.rotors[0], tflm.parameters(made)
    made = replace(
        made, rotors=tuple(replace(each, thrust_map=(0.0, 0.0, rotor.thrust_map[2])) for each in made.rotors)
    )
    numbers = tflm.parameters(made)
    assert 0.01 <= numbers["MC_NN_THRST_COEF"] <= 5.0
    thrust = np.linspace(0.0, rotor.thrust_range[1], 9)
    action = thrust / tflm.thrust_unit(made) - 1.0
    assert np.abs(action).max() <= 1.0, "the module limits actions"
    rpm = 60.0 * np.sqrt((action + 1.0) / (1e-5 * numbers["MC_NN_THRST_COEF"]))
    np.testing.assert_allclose(rotor.thrust_map[2] * (2.0 * pi * rpm / 60.0) ** 2, thrust, rtol=1e-9)
    assert numbers["MC_NN_MAX_RPM"] == round(rpm[-1])


def test_files_of_the_module(tmp_path: Path) -> None:
    policy, made = relu_policy()
    model = write_policy(policy, made, tmp_path, ["tflm"], check=False)[0].file
    text = (model.parent / "control_net.cpp").read_text()
    numbers = bytes(int(each, 16) for each in text.partition("{")[2].partition("}")[0].replace(",", " ").split())
    assert numbers == model.read_bytes()
    assert f"control_net_tflite_size = {len(numbers)};" in (model.parent / "control_net.hpp").read_text()
    lines = (model.parent / "hover.params").read_text().splitlines()
    rows = {name: (value, kind) for _, _, name, value, kind in (x.split("\t") for x in lines if x[0] != "#")}
    assert rows["MC_NN_MIN_RPM"] == ("0", "6")
    assert rows["MC_NN_MAX_RPM"] == (str(round(60.0 * (20.0 / 8.54858e-6) ** 0.5 / (2.0 * pi))), "6")
    assert float(rows["MC_NN_THRST_COEF"][0]) == pytest.approx(
        1e5 * 8.54858e-6 * 4.0 * pi**2 / tflm.thrust_unit(made), rel=1e-6
    )
    assert any("differs from that of x500 by" in line for line in lines)


def test_faults_of_a_policy_are_listed_at_once(tmp_path: Path) -> None:
    policy = random_policy(19, activation="elu", memory=4)
    made = engine_layout(policy, (*TERMS, "policy_action"), kind="speed")
    rotors = (replace(made.rotors[0], thrust_range=(-0.1, 0.1)), *made.rotors[1:])
    made = replace(made, rotors=rotors, params={"low": (0.0, 0.0, 0.0, 0.1), "high": (1.0,) * 4})
    with pytest.raises(ConfigError) as error:
        write_policy(policy, made, tmp_path, ["tflm"])
    words = (
        "observes policy_action",
        "controller no_control",
        "backwards",
        "one for all",
        "export raptor",
        "activation: relu",
    )
    assert len(error.value.args) == len(words)
    for fault, word in zip(error.value.args, words, strict=True):
        assert word in fault


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"mode": "force", "thrust_map": (0.0, 1.0, 0.0)}, "have no speed"),
        ({"thrust_map": (0.0, 0.0, 1e-10)}, "MC_NN_MAX_RPM ends at 80000"),
        ({"thrust_map": (0.0, 0.0, 1e-9), "thrust_range": (0.0, 0.05)}, ""),
    ],
)
def test_rotors_that_the_module_cannot_turn_are_refused(change: dict[str, object], word: str) -> None:
    policy, made = relu_policy()
    made = replace(made, rotors=tuple(replace(rotor, **change) for rotor in made.rotors))  # pyright: ignore
    if "thrust_range" in change:
        made = replace(made, params={"low": (0.0,) * 4, "high": (0.05,) * 4})
    faults = list(tflm.faults(DeployablePolicy(policy, made), made))
    assert len(faults) == (1 if word else 0), faults
    assert all(word in fault for fault in faults)


def test_layers_too_wide_for_the_memory_of_the_module_are_refused() -> None:
    policy = random_policy(15, activation="relu", hidden_layers=(1300, 1300))
    made = engine_layout(policy, TERMS, robot="x500")
    (fault,) = tflm.faults(DeployablePolicy(policy, made), made)
    assert "two layers take 10400 B, and the module has 10240 B for all. Train with smaller hidden_layers" in fault


def test_without_the_engine_a_model_is_written_and_not_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    policy, made = relu_policy()
    (result,) = write_policy(policy, made, tmp_path, ["tflm"])
    assert result.file.is_file()
    assert "make firmware-tools" in str(result.not_checked)
