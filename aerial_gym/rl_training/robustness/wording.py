"""All sentences of a robustness test: labels of cells and variants, and the advice for a cell in which success is lost."""

from collections.abc import Sequence
from math import degrees

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import Parameter
from aerial_gym.rl_training.robustness.cell import Cell

STAND = "measure it on a test stand (aerial-gym identify motor)"
SWING = "measure the inertia by throws or swings"
CALM = "fly in calmer air"
UNLOAD = "fly without the load"
INSPECT = "inspect motors and propellers before each flight"

EFFECT_WORDS = {
    "com_offset": ("centre of mass off by", "weigh the vehicle on three supports"),
    "payload_mass": ("mass off by", "weigh the vehicle as it flies"),
    "thrust_coefficient": ("thrust of all rotors off by", "measure the thrust at hover (aerial-gym identify hover)"),
    "weak_motor": ("thrust of one rotor off by", "compare the rotors on a test stand and replace the odd one"),
    "motor_gain": ("speed of one rotor off by", "compare the rotors on a test stand and replace the odd one"),
    "torque_ratio": ("yaw torque off by", STAND), "motor_time_constant": ("rotor lag off by", STAND),
    "motor_asymmetry": ("rotor lag of rise or fall off by", STAND), "motor_tilt": ("one rotor tilted by", "align the mounts"),
    "actuation_delay": ("dead time of the rotors of", "measure the time from command to thrust"),
    "arm_length": ("arm length off by", "measure the distance between the motors"),
    "inertia_error": ("moment of inertia off by", SWING), "products_of_inertia": ("product of inertia off by", SWING),
    "constant_wind": ("steady wind of", CALM), "wind_shear": ("wind at reference height of", CALM), "gusts": ("gusts of", CALM),
    "random_force": ("random force of", CALM), "slung_payload": ("slung load of", UNLOAD),
    "slung_payload_rod": ("slung rod of", UNLOAD), "stuck_rotor": ("one rotor that sticks after 1 s", INSPECT),
    "motor_failure": ("speed of one rotor reduced from 1 s on by", INSPECT),
    "brown_out": ("speed of all rotors reduced for 0.5 s by", "check the power supply under full load"),
}  # fmt: skip
"""Description of an effect before its size, and the check for it; others have their name, and are found in flights."""

LINK_WORDS = {
    "rate": ("policy at {:g} Hz", "run the policy at the rate of its training, or train at this rate (--set sim.dt)"),
    "delay": ("commands {:g} ms late", "shorten the delay of the link, or train with it (--set task.action.delay_steps)"),
    "packet_loss": ("{:g} % of observations lost", "improve the link, or train with dropout of the observations"),
    "noise": ("{:g} x the noise of real sensors", "filter the state estimate, or train with noise_std of the observations"),
    "neutral": ("all effects at their neutral values", "these effects are not neutral: please report it"),
    "ranges": ("all intervals of the close-loop result", "narrow them with more flights, or train on that robot file"),
}  # fmt: skip
"""Description and advice of conditions that are no effects."""

LOSSES = {"fails": "Most flights fail", "degrades": "Fewer flights succeed"}  # By outcome


def amount_text(parameter: Parameter, change: float) -> str:
    """Return the size of a change with its unit: ``10 mm``."""
    unit = parameter.unit
    if unit == "-":
        return f"{100.0 * change:.3g} %" if parameter.neutral == 1.0 else f"{change:.3g}"
    if unit == "rad":
        return f"{degrees(change):.2g}°"
    small = {"m": "mm", "s": "ms", "kg": "g"}
    return f"{1e3 * change:.3g} {small[unit]}" if unit in small and abs(change) < 0.1 else f"{change:.3g} {unit}"


def cell_label(subject: str, size: float, sized: Sequence[Parameter] = ()) -> str:
    """Return the description of a cell: of an effect with ``size`` times the scale of its parameters, or of another kind."""
    if subject in LINK_WORDS:
        return LINK_WORDS[subject][0].format({"delay": 1e3, "packet_loss": 1e2}.get(subject, 1.0) * size)
    amounts = dict.fromkeys(amount_text(each, size * each.scale) for each in sized)
    words = EFFECT_WORDS[subject][0] if subject in EFFECT_WORDS else f"{subject.replace('_', ' ')} of"
    return f"{words} {' or '.join(amounts)}".rstrip()


def variant_label(rotor: int | None, parameter: Parameter | None = None, change: float = 0.0) -> str:
    """Return the rotor, parameter and sign of a variant: ``rotor 2, x -10 mm``."""
    parts = [] if rotor is None else [f"rotor {rotor}"]
    if parameter is not None:
        parts.append(f"{parameter.name} {'+' if change > 0.0 else ''}{amount_text(parameter, change)}")
    return ", ".join(parts)


def advice_text(cell: Cell, outcome: str, worst: str) -> str:
    """Return the advice for a cell: the loss, the check that avoids it, and the training that tolerates it."""
    start = f"{LOSSES[outcome]} with {cell.label}{f' (worst: {worst})' if worst else ''}: "
    if cell.subject in LINK_WORDS:
        return start + LINK_WORDS[cell.subject][1]
    _, check = EFFECT_WORDS.get(cell.subject, ("", "find its size in flights (aerial-gym close-loop)"))
    numbers = {each.name for each in EFFECTS.get(cell.subject).parameters if each.kind == "number"}
    changed = dict.fromkeys(key for variant in cell.variants for key in variant.values)
    names = [f"effects.{effect}.{name}" for effect, name in changed if effect == cell.subject and name in numbers]
    drawn = f" or draws {', '.join(names)}" if names else ""
    return f"{start}{check}, or train on a robot file that has it (close-loop --ranges){drawn}"
