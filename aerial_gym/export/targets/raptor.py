"""A policy for PX4's ``mc_raptor``: the archive of its weights that the module loads from the memory card.

The module has one network, that of its ``blob/policy.h``: 22 inputs, a dense layer of 16 with ReLU, a gated recurrent unit of
16 and a dense layer of 4. The archive is a tar file in the form of RLtools: each tensor has an entry ``meta`` with its shape
and an entry ``data`` with float32 numbers, row by row. An example of inputs and outputs lets the module check itself.
Gates are in the order of torch (reset, update, new), and the hidden bias of the new gate is inside the reset gate, as in torch.
Source: github.com/PX4/PX4-Autopilot, ``src/modules/mc_raptor`` (``mc_raptor.cpp``, ``mc_raptor.hpp``, ``blob/policy.h``);
github.com/rl-tools/rl-tools, ``persist/backends/tar/operations_generic.h``, ``nn/layers/gru``, ``inference/applications/l2f``.
Letters: B rows, I inputs.
"""

import io
import tarfile
from collections.abc import Iterator

import torch
from torch import Tensor, nn

from aerial_gym.export.layout import Layout
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.targets import requirements
from aerial_gym.export.targets.requirements import INSTEAD

NAME = "raptor"
INPUTS = {
    "position_error_world": (0, -1.0), "rotation_rows": (3, 1.0), "up_body": (9, 1.0), "lin_vel_world": (12, 1.0),
    "velocity_error_world": (12, -1.0), "ang_vel_body": (15, 1.0), "policy_action": (18, 1.0),
}  # fmt: skip
"""First input and sign of each term: the module measures the position and velocity relative to the setpoint."""

NUM_INPUTS, WIDTH, RATE_HZ = 22, 16, 100.0
MOTORS = tuple(requirements.X_PLACES)  # Order of actions, that of the Crazyflie
EXAMPLE = (500, 2)  # Steps and flights of the example, those of the module's own archive
META_LENGTH = 100  # Longest metadata of a tensor, and of the name of the policy [characters]
PARAMETERS = {"MC_RAPTOR_ENABLE": 1, "MC_RAPTOR_OFFB": 0, "IMU_GYRO_RATEMAX": 400}  # README.md of the module


def faults(policy: DeployablePolicy, layout: Layout) -> Iterator[str]:
    """Yield reasons why ``mc_raptor`` cannot fly a policy."""
    body = policy.policy.body
    yield from requirements.observation_faults(layout, INPUTS, NAME)
    yield from requirements.rotor_faults(layout, ("speed",), NAME)
    yield from requirements.affine_faults(layout, NAME)
    shape = (*body.cfg.hidden_layers, body.cfg.activation, body.memory_size)
    if shape != (WIDTH, "relu", WIDTH):
        yield (
            f"{NAME}: the network has hidden_layers {list(body.cfg.hidden_layers)}, activation {body.cfg.activation}, memory "
            f"{body.memory_size}; the module has [{WIDTH}], relu, {WIDTH}. Train with these, or {INSTEAD}"
        )
    if policy.normalization()[2] is not None:
        yield (
            f"{NAME}: normalised inputs are limited to {policy.normalization()[2]:g} deviations, and the module has no limit. "
            f"Train with normalize_observation: false, or {INSTEAD}"
        )
    if abs(layout.rate_hz - RATE_HZ) > 1e-6:
        yield f"{NAME}: the policy runs at {layout.rate_hz:g} Hz, and the module's memory at {RATE_HZ:g} Hz. Train at 100 Hz"


def files(policy: DeployablePolicy, layout: Layout) -> dict[str, str | bytes]:
    """Return parameters and the archive."""
    parameters = requirements.parameter_file(PARAMETERS, _notes(layout))
    return {f"{layout.name}.params": parameters, "policy.tar": archive(tensors(policy, layout), layout.name)}


def tensors(policy: DeployablePolicy, layout: Layout) -> dict[str, Tensor]:
    """Return the weights by their place in the archive, float32, with scales and normaliser in the first layer."""
    places, signs = module_places(layout)
    matrix, offset = requirements.standardization(policy, places, signs, NUM_INPUTS)
    linear, cell, head = policy.policy.body.layers[0], policy.policy.body.cell, policy.policy.head
    assert isinstance(linear, nn.Linear)
    assert cell is not None
    weight, numbers = linear.weight.double(), requirements.action_numbers(layout, MOTORS)
    made = {
        "layers/0/weights": weight @ matrix, "layers/0/biases": linear.bias.double() + weight @ offset,
        "layers/1/weights_input": cell.weight_ih, "layers/1/biases_input": cell.bias_ih,
        "layers/1/weights_hidden": cell.weight_hh, "layers/1/biases_hidden": cell.bias_hh,
        "layers/1/initial_hidden_state": torch.zeros(WIDTH),
        "layers/2/weights": head.weight[numbers], "layers/2/biases": head.bias[numbers],
    }  # fmt: skip
    return {name: tensor.detach().float() for name, tensor in made.items()}


def module_places(layout: Layout) -> tuple[Tensor, Tensor]:
    """Return the module's input and its sign for each entry of an observation, with actions in the module's order."""
    places, signs = requirements.input_places(layout, INPUTS)
    first, numbers = INPUTS["policy_action"][0], requirements.action_numbers(layout, MOTORS)
    order = torch.tensor([first + numbers.index(action) for action in range(len(numbers))])
    return torch.where(places >= first, order[(places - first).clamp_min(0)], places), signs


def archive(weights: dict[str, Tensor], name: str) -> bytes:
    """Return the archive of weights, with an example of 500 steps of two flights."""
    generator = torch.Generator().manual_seed(0)
    inputs = torch.randn(*EXAMPLE, NUM_INPUTS, generator=generator)
    memory, outputs = inputs.new_zeros(EXAMPLE[1], WIDTH), []
    for row in inputs:
        action, memory = evaluate(weights, row, memory)
        outputs.append(action)
    entries: dict[str, bytes] = {"actor/meta": f"type: sequential\ncheckpoint_name: {name[:META_LENGTH]}\n".encode()}
    groups = {f"actor/{place}/parameters": tensor for place, tensor in weights.items()}
    for place, tensor in (groups | {"example/input": inputs, "example/output": torch.stack(outputs)}).items():
        shape = "".join(f"dim_{number}: {size}\n" for number, size in enumerate(tensor.shape))
        entries[f"{place}/meta"] = f"type: tensor\ndtype: float32\nnum_dims: {tensor.dim()}\n{shape}".encode()
        entries[f"{place}/data"] = tensor.contiguous().numpy().astype("<f4").tobytes()
    with io.BytesIO() as file:
        with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as tar:
            for place, data in entries.items():
                entry = tarfile.TarInfo(place)
                entry.size = len(data)
                tar.addfile(entry, io.BytesIO(data))
        return file.getvalue()


@torch.no_grad()
def evaluate(weights: dict[str, Tensor], inputs: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
    """Return the module's actions (B, 4), not limited, and its memory (B, 16) after inputs (B, I)."""
    features = torch.relu(nn.functional.linear(inputs, weights["layers/0/weights"], weights["layers/0/biases"]))
    gates = (
        weights[f"layers/1/{kind}"] for kind in ("weights_input", "weights_hidden", "biases_input", "biases_hidden")
    )
    memory = torch.gru_cell(features, memory, *gates)
    return nn.functional.linear(memory, weights["layers/2/weights"], weights["layers/2/biases"]), memory


def _notes(layout: Layout) -> Iterator[str]:
    low, high = layout.params["low"][0], layout.params["high"][0]
    yield f"{layout.name} of {layout.task} for {layout.robot} with PX4's mc_raptor; aerial_gym {layout.version}"
    yield "Copy policy.tar to raptor/policy.tar on the memory card."
    yield f"Motor signal 0 is {low:.4g} rad/s, 1 is {high:.4g} rad/s, linear between: set the limits of the outputs so."
    yield "The module flies PX4's Quadrotor X. It limits position errors to 0.5 m and velocity errors to 1 m/s."
    yield "Its memory advances at 100 Hz. Between these steps it evaluates the network, and the memory stays."
