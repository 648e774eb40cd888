"""Sentences on changed vehicles."""

from aerial_gym.fleet.statistics import Change, ChangeResult
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.wording.words import half_width_text, join_words, value_text

THRUST_SHARES = {
    "weak_motor": "thrust",
    "thrust_coefficient": "thrust",
    "motor_gain": "speed",
    "torque_ratio": "drag torque",
}


def text_of_change(result: ChangeResult, vehicle: str) -> str:
    """Return one sentence on the most probable change of a vehicle, with its alternatives."""
    if not result.causes:
        return f"vehicle {vehicle}: too few flights to find a change"
    best, *others = result.candidates
    text = f"vehicle {vehicle}{_rotor_text(best)}: {_size_text(best)} {_onset_text(best)}"
    if result.firmware_change:
        text += f", with the change of firmware from {result.firmware_change[0]} to {result.firmware_change[1]}"
    names = [f"{other.effect.replace('_', ' ')}{_rotor_text(other)}" for other in others]
    return f"{text}; or {join_words(names, 'or')}" if names else text


def _rotor_text(change: Change) -> str:
    return f", rotor {change.rotor}" if change.rotor else ""


def _size_text(change: Change) -> str:
    """Return the changes of an effect's parameters with half their 95 % intervals, in per cent for ratios."""
    units = {parameter.name: parameter.unit for parameter in EFFECTS.get(change.effect).parameters}
    name, parts = THRUST_SHARES.get(change.effect, change.effect.replace("_", " ")), []
    for parameter, value, std in zip(change.parameters, change.change, change.std, strict=True):
        is_ratio = units[parameter] == "-"
        factor, unit = (100.0, "%") if is_ratio else (1.0, units[parameter])
        half = 1.96 * factor * std
        axis = f" {parameter}" if len(change.parameters) > 1 else ""
        parts.append(
            f"{'+' if value > 0.0 else ''}{value_text(factor * value, half)} {unit}{axis} ({half_width_text(half, unit)})"
        )
    return f"{join_words(parts)} {name}"


def _onset_text(change: Change) -> str:
    """Return the first changed flight, counted from 1, with its 90 % interval if it is not certain."""
    first, low, high = change.onset + 1, change.onset_low + 1, change.onset_high + 1
    word = "since" if change.kind == "step" else "as a drift since"
    return f"{word} flight {first}" + (f" (90 % interval {low} to {high})" if low < high else "")
