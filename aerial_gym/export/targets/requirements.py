"""Requirements of vehicle engines: reasons why a policy does not fit one, each with the alternative; and their inputs.

Letters: B rows, O entries of an observation, I inputs of an engine.
"""

from collections.abc import Iterable, Iterator, Mapping

import torch
from torch import Tensor

from aerial_gym.export.layout import Layout, LayoutRotor
from aerial_gym.export.module import DeployablePolicy, action_transform
from aerial_gym.task.terms import actions

X_PLACES = {"front right": (1, -1), "back right": (-1, -1), "back left": (-1, 1), "front left": (1, 1)}
"""Signs of x and y of the rotors of a quadrotor in X, by place."""

INSTEAD = "export c99 or onnx for your own code"


def observation_faults(layout: Layout, known: Iterable[str], target: str) -> Iterator[str]:
    """Yield what an engine cannot observe; ``known`` are the terms that it measures."""
    for image in layout.images:
        yield f"{target}: the policy sees the images {image.key!r}, and the engine has none. Fly onnx on a companion computer"
    known = tuple(known)
    for seen in layout.observation:
        if seen.term not in known:
            yield (
                f"{target}: the policy observes {seen.term}, which the engine does not measure. It knows {', '.join(known)}. "
                f"Train with these, or {INSTEAD}"
            )
        elif seen.history > 1:
            yield (
                f"{target}: the policy observes {seen.history} steps of {seen.term}; the engine keeps no history. Train with "
                f"history: 1 or a memory, or {INSTEAD}"
            )


def rotor_faults(layout: Layout, kinds: Iterable[str], target: str) -> Iterator[str]:
    """Yield why an engine cannot command the rotors of a policy; ``kinds`` of commands are ``speed`` and ``thrust``."""
    kinds, controllers = tuple(kinds), {"speed": "rotor_speed_control", "thrust": "no_control"}
    names = tuple(f"{kind} " for kind in kinds)
    if len(layout.command) != 4 or not all(name.startswith(names) for name in layout.command):
        wanted = " or ".join(controllers[kind] for kind in kinds)
        yield (
            f"{target}: the policy commands {', '.join(layout.command)}; the engine takes the {' or '.join(kinds)} of four "
            f"rotors. Train with controller {wanted}, or {INSTEAD}"
        )
    if sorted(map(rotor_place, layout.rotors)) != sorted(X_PLACES):
        yield (
            f"{target}: {layout.robot} has {len(layout.rotors)} rotors at "
            f"{', '.join(map(rotor_place, layout.rotors))}; the engine flies a quadrotor in X. {INSTEAD.capitalize()}"
        )
    if any(rotor.thrust_range[0] < 0.0 for rotor in layout.rotors):
        yield f"{target}: rotors of {layout.robot} turn backwards, and the engine's do not. {INSTEAD.capitalize()}"


def rotor_place(rotor: LayoutRotor) -> str:
    """Return the name of a rotor's quadrant; its position where it is on an axis."""
    x, y, _ = rotor.position
    signs = ((x > 0) - (x < 0), (y > 0) - (y < 0))
    return next((name for name, place in X_PLACES.items() if place == signs), f"({x:g}, {y:g}) m")


def rotor_numbers(layout: Layout, places: Iterable[str]) -> list[int]:
    """Return the number of the command of the rotor at each place."""
    numbers = {rotor_place(rotor): number for number, rotor in enumerate(layout.rotors)}
    return [numbers[place] for place in places]


def input_places(layout: Layout, inputs: Mapping[str, tuple[int, float]]) -> tuple[Tensor, Tensor]:
    """Return the number of the engine's input and its sign for each entry of an observation, (O,).

    Args:
        inputs: Number of the first input, and sign, of each term that the engine measures.
    """
    entries = [(inputs[seen.term], entry) for seen in layout.observation for entry in range(seen.count)]
    return torch.tensor([first + entry for (first, _), entry in entries]), torch.tensor(
        [sign for (_, sign), _ in entries]
    )


def standardization(policy: DeployablePolicy, places: Tensor, signs: Tensor, num_inputs: int) -> tuple[Tensor, Tensor]:
    """Return the matrix (O, I) and the offset (O,) from an engine's inputs to the normalised observation, float64."""
    mean, std, _ = policy.normalization()
    matrix = torch.zeros(len(places), num_inputs, dtype=torch.float64)
    matrix[torch.arange(len(places)), places] = signs.double() * policy.scale.double() / std.double()
    return matrix, -(mean.double() / std.double())


def engine_inputs(observation: Tensor, places: Tensor, signs: Tensor, num_inputs: int) -> Tensor:
    """Return an engine's inputs (B, I) of observations (B, O) in their own units; 0 where the policy does not look."""
    rows = observation.new_zeros(len(observation), num_inputs)
    rows[:, places] = observation * signs
    return rows


def action_numbers(layout: Layout, places: Iterable[str]) -> list[int]:
    """Return the number of the action behind the command of the rotor at each place, of an ``affine`` transform."""
    order = layout.params.get("order") or range(len(layout.rotors))
    return [order[number] for number in rotor_numbers(layout, places)]


def affine_faults(layout: Layout, target: str) -> Iterator[str]:
    """Yield why commands are not the same linear function of the action for all rotors."""
    transform, params = action_transform(layout)
    if transform is not actions.affine:
        yield f"{target}: the action {layout.transform} is no linear map for each rotor. Train with rotor_range, or {INSTEAD}"
    elif len(set(zip(params["low"], params["high"], strict=True))) > 1:
        yield f"{target}: the action has a range for each rotor, the engine one for all. Make them equal, or {INSTEAD}"


def parameter_file(values: Mapping[str, float], notes: Iterable[str]) -> str:
    """Return parameters in the form that QGroundControl loads; whole numbers are integers of PX4."""
    lines = [f"# {note}" for note in notes]
    types = {True: (6, "d"), False: (9, ".9g")}  # MAV_PARAM_TYPE_INT32 and REAL32
    for name, value in values.items():
        number, form = types[isinstance(value, int)]
        lines.append(f"1\t1\t{name}\t{value:{form}}\t{number}")
    return "\n".join(lines) + "\n"
