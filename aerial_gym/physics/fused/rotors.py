"""Warp functions of the rotors of one environment, traced from ``physics.rotor_lag``: lag, slew limit and dead band.

Rotors with a first-order lag alone have decays over a stage of the integrator; their time is in stages.
Letters: R rotors.
"""

from collections.abc import Callable, Sequence
from functools import cache
from types import SimpleNamespace
from typing import cast

import warp as wp
from torch import Tensor

from aerial_gym.physics.fused.readers import compile_source
from aerial_gym.physics.fused.row_model import VehicleRows
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.fused.types import rotor_types
from aerial_gym.physics.rotor_lag import (
    CommandSwitch,
    DecayLag,
    RotorCommand,
    RotorLag,
    SlewLimitedLag,
    follow_command,
    stage_rates,
    stop_in_dead_band,
)
from aerial_gym.physics.vehicle import Vehicle

SLEW_LIMITED = "tau_up", "tau_down", "slew_up", "slew_down"
DECAYS = "decay_up", "decay_down"
"""Fields of the vehicle that are the fields of ``SlewLimitedLag`` and ``DecayLag``."""


@cache
def make_follow(num_rotors: int, general: bool, late: bool = False, *, stages: int = 1) -> wp.Function:
    """Return the function of the states after one or two stages, (vehicle, states, commands, span [s]) -> states.

    Two stages in one call are rounded once. A state near its command stops once its change in a stage is below half a unit in
    the last place, so separate stages end twice as far from the command. With ``late``, the command changes within a step.
    """

    def follow(lag: RotorLag, states: list[Tensor], command: CommandOf, span: Tensor) -> tuple[Tensor]:
        if general:
            return (follow_command(lag, states[0], command(1.0), span),)
        return (follow_command(lag, states[0], command(stages / span), float(stages)),)

    return _trace_each_rotor("follow", follow, ["state"], 1, num_rotors, general, late)


@cache
def make_stage_rates(num_rotors: int, general: bool, late: bool = False) -> wp.Function:
    """Return the function of the rates of change in a step of two stages, (vehicle, three states, commands, step [s])."""

    def rates(lag: RotorLag, states: list[Tensor], command: CommandOf, dt: Tensor) -> tuple[Tensor, ...]:
        start, middle, end = states
        if general:
            return stage_rates(lag, (start, middle, end), command(1.0), dt)
        scale = 2.0 / dt
        return tuple(scale * rate for rate in stage_rates(lag, (start, middle, end), command(scale), 2.0))

    return _trace_each_rotor("stage_rates", rates, ["start", "middle", "end"], 3, num_rotors, general, late)


CommandOf = Callable[[Tensor | float], RotorCommand]
"""Function from a factor of times to the command."""


def _trace_each_rotor(
    name: str,
    function: Callable[[RotorLag, list[Tensor], CommandOf, Tensor], tuple[Tensor, ...]],
    states: Sequence[str],
    num_results: int,
    num_rotors: int,
    general: bool,
    late: bool,
) -> wp.Function:
    """Return the function (vehicle, states, commands, span [s]) that calls a traced function of one rotor for each rotor.

    One trace for all rotors would mix their operations, which takes more registers.
    """
    types, fields = rotor_types(num_rotors, general), SLEW_LIMITED if general else DECAYS
    commands = ("earlier", "later", "change") if late else ("command",)

    def one(span: Tensor, **rows: Tensor) -> tuple[Tensor, ...]:
        lag = (SlewLimitedLag if general else DecayLag)(*(rows[field] for field in fields))

        def command(scale: Tensor | float) -> RotorCommand:
            if not late:
                return rows["command"]
            return CommandSwitch(earlier=rows["earlier"], later=rows["later"], change=rows["change"] * scale)

        return function(lag, [rows[state] for state in states], command, span)

    floats = dict.fromkeys((*fields, *states, *commands, "span"), float)
    traced = trace_to_warp(f"{name}_one", floats, one, [float] * num_results, constants={})
    numbers = [f"plant.{field}[i]" for field in fields] + [f"{state}[i]" for state in states]
    numbers += ["command.earlier[i]", "command.later[i]", "command.change"] if late else ["command[i]"]
    kinds = {"plant": types.vehicle, **dict.fromkeys(states, types.vector)}
    kinds |= {"command": types.succession if late else types.vector, "span": float}
    results = [f"after_{k}" for k in range(num_results)]
    code = [
        f"def {name}({', '.join(f'{argument}: {argument}_type' for argument in kinds)}):",
        *(f"    {result} = vector()" for result in results),
        f"    for i in range({num_rotors}):",
        f"        {', '.join(f'{result}_i' for result in results)} = one({', '.join(numbers)}, span)",
        *(f"        {result}[i] = {result}_i" for result in results),
        f"    return {', '.join(results)}",
    ]
    names = {f"{argument}_type": kind for argument, kind in kinds.items()} | {"one": traced, "vector": types.vector}
    return compile_source(name, "\n".join(code) + "\n", names)


@cache
def make_dead_band(num_rotors: int) -> wp.Function:
    """Return ``rotor_lag.stop_in_dead_band`` as a function (vehicle, commands) -> commands."""
    types = rotor_types(num_rotors, general=True)

    def stop(plant: SimpleNamespace, command: Tensor) -> Tensor:
        return stop_in_dead_band(cast(Vehicle, VehicleRows(**vars(plant), traits=frozenset({"dead_band"}))), command)

    arguments = {"plant": types.vehicle, "command": types.vector}
    return trace_to_warp("stop_in_dead_band", arguments, stop, [types.vector], constants={})
