"""Archives for PX4's ``mc_raptor``: bytes, weights and actions by a reader of its own, and policies that it cannot fly.

``tests/slow/test_raptor_engine.py`` loads them with RLtools."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.errors import ConfigError
from aerial_gym.export.export import write_policy
from aerial_gym.export.layout import Layout
from aerial_gym.export.targets import raptor
from aerial_gym.rl_training import Policy
from tests.engines.policies import commands, engine_layout, random_states
from tests.unit.export.policies import random_policy

TERMS = ("position_error_world", "rotation_rows", "lin_vel_world", "ang_vel_body", "policy_action")
ORDER = (2, 0, 3, 1)  # of the action entry of each rotor: another than that of the rotors


def raptor_policy(robot: str = "x500") -> tuple[Policy, Layout]:
    policy = random_policy(19, activation="relu", memory=16, normalize=False, hidden_layers=(16,))
    policy.head.weight.data *= 0.5
    made = engine_layout(policy, TERMS, kind="speed", robot=robot, scale=0.5)
    return policy, replace(made, params={**made.params, "order": ORDER})


def read_archive(data: bytes) -> dict[str, bytes]:
    """Return the entries of a ustar archive by the layout of its headers, as RLtools reads them."""
    entries, place = {}, 0
    while data[place] != 0:
        header = data[place : place + 512]
        assert header[257:262] == b"ustar"
        assert header[156:157] == b"0", "a regular file"
        size = int(header[124:136].rstrip(b"\0 "), 8)
        checked = header[:148] + b" " * 8 + header[156:]
        assert int(header[148:156].rstrip(b"\0 "), 8) == sum(checked)
        entries[header[:100].rstrip(b"\0").decode()] = data[place + 512 : place + 512 + size]
        place += 512 + -(-size // 512) * 512
    assert not any(data[place : place + 1024]), "two empty blocks at the end"
    return entries


def read_tensor(entries: dict[str, bytes], name: str) -> np.ndarray:
    meta = dict(line.split(": ") for line in entries[f"{name}/meta"].decode().splitlines())
    assert (meta["type"], meta["dtype"]) == ("tensor", "float32")
    assert len(entries[f"{name}/meta"]) < 100, "the reader has a buffer of 100 B"
    shape = [int(meta[f"dim_{i}"]) for i in range(int(meta["num_dims"]))]
    values = struct.unpack(f"<{len(entries[f'{name}/data']) // 4}f", entries[f"{name}/data"])
    return np.array(values).reshape(shape)


def module_step(entries: dict[str, bytes], inputs: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return actions and memory of the network of the module, in float64."""

    def layer(number: int, kind: str, given: np.ndarray, suffix: str = "") -> np.ndarray:
        place = f"actor/layers/{number}"
        weights, biases = (read_tensor(entries, f"{place}/{name}{suffix}/parameters") for name in ("weights", "biases"))
        result = given @ weights.T + biases
        return np.maximum(result, 0.0) if kind == "relu" else result

    features = layer(0, "relu", inputs)
    seen, held = layer(1, "", features, "_input"), layer(1, "", memory, "_hidden")
    reset, update = (1.0 / (1.0 + np.exp(-(seen + held)[:, part])) for part in (slice(0, 16), slice(16, 32)))
    fresh = np.tanh(seen[:, 32:] + reset * held[:, 32:])
    memory = (1.0 - update) * fresh + update * memory
    return layer(2, "", memory), memory


def test_the_archive_flies_as_the_policy(tmp_path: Path) -> None:
    """Flights of 10 steps in the inputs of ``mc_raptor``, which are made of states without code of the export: the motor
    signal of each place is the rotor speed of the policy at that place, as a share of its range."""
    policy, made = raptor_policy()
    (result,) = write_policy(policy, made, tmp_path, ["raptor"])
    assert result.agrees is None, "RLtools, the engine, is not here"
    entries, states = read_archive(result.file.read_bytes()), random_states(2_000)
    expected = commands(policy.double(), made, states.double()).numpy()
    memory, action = np.zeros((200, 16)), np.zeros((200, 4))
    x, y, z, w = states.quaternion.double().numpy().T
    rotation = np.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
         2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1,
    )  # fmt: skip
    offset = (states.position - states.target).double().numpy()
    for step in range(10):
        now = slice(step, None, 10)
        parts = (offset, rotation, states.velocity.double().numpy(), states.ang_vel.double().numpy())
        raw, memory = module_step(entries, np.concatenate([*(part[now] for part in parts), action], axis=1), memory)
        action = np.clip(raw, -1.0, 1.0)
        front_right, back_right, back_left, front_left = action.T
        rotors = np.stack((front_right, back_left, front_left, back_right), axis=1)  # order of x500
        high, low = made.params["high"][0], made.params["low"][0]
        np.testing.assert_allclose(low + 0.5 * (high - low) * (rotors + 1.0), expected[now], atol=2e-5 * high)
    assert (np.abs(action) < 0.99).mean() > 0.3


def test_entries_that_the_module_reads(tmp_path: Path) -> None:
    policy, made = raptor_policy()
    file = write_policy(policy, made, tmp_path, ["raptor"], check=False)[0].file
    entries = read_archive(file.read_bytes())
    assert b"\ncheckpoint_name: hover\n" in entries["actor/meta"]
    assert len(entries["actor/meta"]) < 256
    shapes = {name: read_tensor(entries, f"actor/layers/{name}/parameters").shape for name in (
        "0/weights", "0/biases", "1/weights_input", "1/biases_input", "1/weights_hidden", "1/biases_hidden",
        "1/initial_hidden_state", "2/weights", "2/biases",
    )}  # fmt: skip
    assert list(shapes.values()) == [(16, 22), (16,), (48, 16), (48,), (48, 16), (48,), (16,), (4, 16), (4,)]
    inputs, outputs = (read_tensor(entries, f"example/{name}") for name in ("input", "output"))
    assert (inputs.shape, outputs.shape) == ((500, 2, 22), (500, 2, 4))
    memory, errors = np.zeros((2, 16)), []
    for row, wanted in zip(inputs[:5], outputs[:5], strict=True):
        action, memory = module_step(entries, row, memory)
        errors.append(np.abs(action - wanted).mean())
    assert np.mean(errors) < 1e-5, "the module refuses the archive"


def test_inputs_that_a_policy_does_not_use_have_no_weight(tmp_path: Path) -> None:
    policy, made = raptor_policy()
    file = write_policy(policy, made, tmp_path, ["raptor"], check=False)[0].file
    weights = read_tensor(read_archive(file.read_bytes()), "actor/layers/0/weights/parameters")
    assert not weights[:, 9:12].any(), "the third row of the rotation matrix"
    assert np.abs(np.delete(weights, (9, 10, 11), axis=1)).min() > 0.0


def test_faults_of_a_policy_are_listed_at_once(tmp_path: Path) -> None:
    policy = random_policy(16, memory=8)
    made = replace(engine_layout(policy, (*TERMS[:4], "zero")), rate_hz=50.0, transform="direct", params={})
    with pytest.raises(ConfigError) as error:
        write_policy(policy, made, tmp_path, ["raptor"])
    words = (
        "observes zero", "controller rotor_speed_control", "rotor_range", "the module has [16], relu, 16",
        "normalize_observation: false", "Train at 100 Hz",
    )  # fmt: skip
    assert len(error.value.args) == len(words)
    for fault, word in zip(error.value.args, words, strict=True):
        assert word in fault
    assert raptor.RATE_HZ == 100.0
