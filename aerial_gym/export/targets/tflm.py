"""A policy for PX4's ``mc_nn_control``: a model for TensorFlow Lite Micro, and the parameters of its action.

The module gives 15 observations in its own order and takes four actions in the order of PX4's Quadrotor X. It registers fully
connected layers, ReLU and sums, so that limits are two ReLUs: ``clamp(x, -l, l) = relu(x + l) - relu(x - l) - l``.
It reads an action as thrust: ``rpm = 60 sqrt(1e5 (action + 1) / MC_NN_THRST_COEF)``. The last layer therefore gives
``F / unit - 1`` of the thrust F [N]; the unit [N] keeps the parameter in its range.
Source: github.com/PX4/PX4-Autopilot, ``src/modules/mc_nn_control``: ``mc_nn_control.cpp`` (observations, frames, arena),
``nn_control_model.hpp`` (operators), ``actions_rescale.hpp`` (action), ``mc_nn_control_params.yaml`` (ranges).
"""

from collections.abc import Iterator
from itertools import pairwise
from math import pi

import torch
from torch import Tensor, nn

from aerial_gym.export.layout import Layout
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.targets import requirements
from aerial_gym.export.targets.flatbuffer import Dense, dense_model
from aerial_gym.export.targets.requirements import INSTEAD
from aerial_gym.physics.catalog import ROTOR_MAPS

NAME = "tflm"
INPUTS = {  # First input and sign of each term
    "position_error_world": (0, 1.0), "rotation_rows": (3, 1.0), "lin_vel_world": (9, 1.0), "ang_vel_body": (12, 1.0),
}  # fmt: skip
NUM_INPUTS = 15
MOTORS = ("front right", "back left", "front left", "back right")  # Motors 1 to 4 of PX4's Quadrotor X
ARENA = 10 * 1024  # Memory of the module for all layers [B]
COEFFICIENTS = (0.01, 5.0)  # Range of MC_NN_THRST_COEF
MOST_RPM = 80_000  # Of MC_NN_MAX_RPM
SAMPLES = 101  # Thrusts at which the thrust curve is compared


def faults(policy: DeployablePolicy, layout: Layout) -> Iterator[str]:
    """Yield reasons why ``mc_nn_control`` cannot fly a policy."""
    body = policy.policy.body
    yield from requirements.observation_faults(layout, INPUTS, NAME)
    rotors = [*requirements.rotor_faults(layout, ("thrust",), NAME), *requirements.affine_faults(layout, NAME)]
    yield from rotors
    if body.memory_size:
        yield f"{NAME}: the policy has a memory, and the module keeps none. Train with memory: 0, or export raptor"
    if body.cfg.activation != "relu":
        yield (
            f"{NAME}: the activation is {body.cfg.activation}, and the module registers FullyConnected, Relu and Add. Train "
            f"with activation: relu, or {INSTEAD}"
        )
    if not layout.images and not body.memory_size and (size := _largest_pair(policy, layout)) > ARENA:
        yield f"{NAME}: two layers take {size} B, and the module has {ARENA} B for all. Train with smaller hidden_layers"
    if not rotors:
        yield from _rotor_type_faults(layout)


def _rotor_type_faults(layout: Layout) -> Iterator[str]:
    if any(rotor.mode != "speed" for rotor in layout.rotors):
        yield f"{NAME}: rotors of {layout.robot} have no speed, which the module computes. Give mode: speed with a thrust_map"
    elif len({(rotor.rotor_map, rotor.thrust_map, rotor.thrust_range) for rotor in layout.rotors}) > 1:
        yield f"{NAME}: rotors of {layout.robot} differ, and the module has one thrust curve. {INSTEAD.capitalize()}"
    elif (rpm := parameters(layout)["MC_NN_MAX_RPM"]) > MOST_RPM:
        yield f"{NAME}: rotors of {layout.robot} reach {rpm} rpm, MC_NN_MAX_RPM ends at {MOST_RPM}. {INSTEAD.capitalize()}"
    elif not (value := parameters(layout)["MC_NN_THRST_COEF"]) >= COEFFICIENTS[0]:
        yield f"{NAME}: MC_NN_THRST_COEF = {value:.3g} is below its range from {COEFFICIENTS[0]}. {INSTEAD.capitalize()}"


def files(policy: DeployablePolicy, layout: Layout) -> dict[str, str | bytes]:
    """Return parameters, the sources that the module compiles, and the model."""
    model = dense_model(layers(policy, layout), f"{layout.name} of {layout.task}; aerial_gym {layout.version}")
    numbers = ", ".join(f"{'' if i % 16 else chr(10)}0x{byte:02x}" for i, byte in enumerate(model))
    return {
        f"{layout.name}.params": requirements.parameter_file(parameters(layout), _notes(layout)),
        "control_net.hpp": "#pragma once\n\n#include <cstdint>\n\n"
        f"constexpr unsigned int control_net_tflite_size = {len(model)};\nextern const unsigned char control_net_tflite[];\n",
        "control_net.cpp": '#include "control_net.hpp"\n\n'
        f"alignas(16) const unsigned char control_net_tflite[] = {{{numbers}\n}};\n",
        f"{layout.name}.tflite": model,
    }


def layers(policy: DeployablePolicy, layout: Layout) -> list[Dense]:
    """Return a policy as dense layers from the module's observations to its actions.

    The first layer has a weight for each pair of input and output, also where it is 0: so NaN and infinity reach all outputs.
    """
    matrix, offset = requirements.standardization(policy, *requirements.input_places(layout, INPUTS), NUM_INPUTS)
    linears = [layer for layer in policy.policy.body.layers if isinstance(layer, nn.Linear)]
    (weight, bias), limit = (each.double() for each in (linears[0].weight, linears[0].bias)), policy.normalization()[2]
    if limit is None:
        made = [Dense(matrix, offset, relu=False)]
    else:
        made = [Dense(torch.cat((matrix, matrix)), torch.cat((offset + limit, offset - limit)), relu=True)]
        weight, bias = torch.cat((weight, -weight), dim=1), bias - limit * weight.sum(1)
    made.append(Dense(weight, bias, relu=True))
    made += [Dense(layer.weight.double(), layer.bias.double(), relu=True) for layer in linears[1:]]
    numbers, head = requirements.action_numbers(layout, MOTORS), policy.policy.head
    weight, bias = head.weight.double()[numbers], head.bias.double()[numbers]
    made.append(Dense(torch.cat((weight, weight)), torch.cat((bias + 1.0, bias - 1.0)), relu=True))
    low, high, unit = *_thrusts(layout), thrust_unit(layout)
    half = 0.5 * (high - low) / unit * torch.eye(len(numbers), dtype=torch.float64)
    made.append(Dense(torch.cat((half, -half), dim=1), torch.full((len(numbers),), low / unit - 1.0), relu=False))
    return made


def thrust_unit(layout: Layout) -> float:
    """Return the thrust [N] of one unit of the module's action."""
    return max(0.5 * _thrusts(layout)[1], 1e5 * _thrust_per_square(layout) / COEFFICIENTS[1])


def parameters(layout: Layout) -> dict[str, float]:
    """Return the parameters of the module."""
    low, high = (round(60.0 * speed) for speed in _revolutions(layout, layout.rotors[0].thrust_range))
    coefficient = 1e5 * _thrust_per_square(layout) / thrust_unit(layout)
    return {"MC_NN_EN": 1, "MC_NN_MIN_RPM": low, "MC_NN_MAX_RPM": high, "MC_NN_THRST_COEF": coefficient}


def commands(layout: Layout, actions: Tensor) -> tuple[Tensor, Tensor]:
    """Return commands and actions (B, 4) of the policy behind the module's actions (B, 4)."""
    (low, high), thrust = _thrusts(layout), thrust_unit(layout) * (actions + 1.0)
    command, action = torch.empty_like(actions), torch.empty_like(actions)
    command[:, requirements.rotor_numbers(layout, MOTORS)] = thrust
    action[:, requirements.action_numbers(layout, MOTORS)] = 2.0 * (thrust - low) / (high - low) - 1.0
    return command, action


def _thrusts(layout: Layout) -> tuple[float, float]:
    return layout.params["low"][0], layout.params["high"][0]


def _revolutions(layout: Layout, thrusts: Iterator[float] | tuple[float, ...]) -> list[float]:
    """Return the speeds of a rotor [1/s] for thrusts [N]."""
    rotor, wanted = layout.rotors[0], torch.tensor(tuple(thrusts), dtype=torch.float64)
    speeds = ROTOR_MAPS.get(rotor.rotor_map).speed_for_thrust(wanted.new_tensor(rotor.thrust_map), wanted)
    return (speeds / (2.0 * pi)).tolist()


def _thrust_per_square(layout: Layout) -> float:
    """Return the thrust per squared speed [N s²] at the highest commanded thrust."""
    high = _thrusts(layout)[1]
    return high / _revolutions(layout, (high,))[0] ** 2


def _notes(layout: Layout) -> Iterator[str]:
    """Yield what the parameters assume."""
    low, high = _thrusts(layout)
    thrusts = torch.linspace(low, high, SAMPLES, dtype=torch.float64)
    squares = torch.tensor(_revolutions(layout, tuple(thrusts.tolist())), dtype=torch.float64).square()
    error = float((_thrust_per_square(layout) * squares - thrusts).abs().max())
    yield f"{layout.name} of {layout.task} for {layout.robot} with PX4's mc_nn_control; aerial_gym {layout.version}"
    yield f"Motors 1 to 4: {', '.join(MOTORS)}. Thrust {low:g} to {high:g} N each."
    yield f"The module's thrust curve c n^2 differs from that of {layout.robot} by {error:.2g} N at most."
    yield "Assumed by the module, not by this file: motor signal 0.8 x^2 + 0.2 x, x from 0 at MIN_RPM to 1 at MAX_RPM."
    yield f"Trained at {layout.rate_hz:g} Hz; the module runs at each sample of the gyro (IMU_GYRO_RATEMAX)."


def _largest_pair(policy: DeployablePolicy, layout: Layout) -> int:
    """Return the bytes of the two neighbouring layers that are largest together, a lower bound of the arena."""
    hidden = [layer.out_features for layer in policy.policy.body.layers if isinstance(layer, nn.Linear)]
    widths = [NUM_INPUTS, 2 * layout.num_observations, *hidden, 8, 4]
    return max(4 * (before + after) for before, after in pairwise(widths))
