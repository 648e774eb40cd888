"""Sentences of findings from templates, and the formats in them: names of errors, units, lists, numbers and intervals."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from math import floor, isfinite, log10
from string import Formatter
from typing import Any

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding, unit_suffix

Values = Mapping[str, Any]

Template = str | Callable[[Finding], str]
"""Text with fields such as ``{share:percent}`` (``FORMATS``) for values and subject, or a function of the finding."""

MOST_LISTED = 5  # Largest number of names in a list; further ones are only counted

_ERRORS = {
    "specific_force.x": "forward-force error",
    "specific_force.y": "sideways-force error",
    "specific_force.z": "vertical-force error",
    "angular_acceleration.x": "roll-acceleration error",
    "angular_acceleration.y": "pitch-acceleration error",
    "angular_acceleration.z": "yaw-acceleration error",
    "kinematic_force.x": "accelerometer error x",
    "kinematic_force.y": "accelerometer error y",
    "kinematic_force.z": "accelerometer error z",
    "kinematic_rate.x": "gyro error x",
    "kinematic_rate.y": "gyro error y",
    "kinematic_rate.z": "gyro error z",
}
"""Names of channel errors; the accelerometer is compared with velocity, the gyro with attitude."""

_VARIANTS = {"free": "", "given_attitude": " with the logged attitude"}


def error_name(quantity: str) -> str:
    """Return the name of a channel's error, or of a rollout's error with or without horizon."""
    if quantity in _ERRORS:
        return _ERRORS[quantity]
    kind, axis, *horizon = quantity.split(".", 2)
    if kind == "rotor_speed":
        return f"speed error of rotor {axis}"
    after = f" after {horizon[0]} s" if horizon else ""
    return f"{axis} error of the rollout{after}{_VARIANTS[kind]}" if kind in _VARIANTS else quantity


def error_list(quantities: Iterable[str]) -> str:
    """Return the names of errors as a list in a sentence."""
    return name_list(map(error_name, quantities))


def quantity_unit(quantity: str) -> str:
    """Return the unit of a channel or of a rollout's quantity."""
    from aerial_gym.sim2real.predict.channels import UNITS  # here, as both need torch
    from aerial_gym.sim2real.predict.rollout import QUANTITIES

    kind, _, rest = quantity.partition(".")
    return UNITS[kind] if kind in UNITS else QUANTITIES[rest.partition(".")[0]]


def value_with_unit_suffix(values: Values, name: str, unit: str) -> Any:
    """Return the value whose key is ``name`` plus the suffix of its unit; None where it is not known."""
    return values[f"{name}_{unit_suffix(unit)}"]


def name_list(items: Iterable[object]) -> str:
    """Return names as a list in a sentence: at most ``MOST_LISTED``, then the number of further ones."""
    names = [str(item) for item in items]
    more = len(names) - MOST_LISTED
    return join_words([*names[:MOST_LISTED], f"{more} more"] if more > 0 else names)


def join_words(parts: Iterable[str], last: str = "and") -> str:
    """Return parts joined by commas and a last word: ``a, b and c``."""
    *before, end = parts
    return f"{', '.join(before)} {last} {end}" if before else end


def number_text(value: float | None, digits: int = 3) -> str:
    """Return a number with ``digits`` significant digits; a dash if it is None or not finite."""
    return "–" if value is None or not isfinite(value) else f"{value:.{digits}g}"


def percent_text(share: float, digits: int = 2) -> str:
    """Return the magnitude of a share in per cent."""
    return f"{float(f'{100.0 * abs(share):.{digits}g}'):g} %"


def rise_interval_text(values: Values) -> str:
    """Return the interval ``rise_low`` to ``rise_high`` in per cent, of new flights if the test flights agree despite it."""
    low, high = (f"{100.0 * float(values[end]):+.0f}" for end in ("rise_low", "rise_high"))
    new = " in new flights, although no test flight contradicts" if values.get("flights_agree") else ""
    return f"{low} to {high} %{new}".replace("inf", "∞")


def decimals_of_half_width(half_width: float | None) -> int | None:
    """Return the decimals that show a half width with one significant digit, or two if the first is 1; None: not known."""
    if half_width is None or not isfinite(half_width) or half_width <= 0.0:
        return None
    place = floor(log10(half_width))
    return max(0, -place + (half_width < 2.0 * 10.0**place))


def value_text(value: float, half_width: float | None) -> str:
    """Return a value with as many decimals as its half width; three significant digits if that is not known."""
    places = decimals_of_half_width(half_width)
    text = f"{value:.3g}" if places is None else f"{value:.{places}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def half_width_text(half_width: float | None, unit: str) -> str:
    """Return ``± half width unit``, or ``interval not known``."""
    places = decimals_of_half_width(half_width)
    space = " " if unit and unit != "°" else ""
    return "interval not known" if places is None else f"± {half_width:.{places}f}{space}{unit}"


def excitation_requirement_text(effect: str) -> str:
    """Return the sentence on the motion that an effect needs."""
    return f"Needed: {EFFECTS.get(effect).excitation}."


def parameter_list(params: Mapping[str, float]) -> str:
    """Return parameters as in a robot file: ``name: value, ...``."""
    return ", ".join(f"{name}: {number_text(value, 4)}" for name, value in params.items())


FORMATS: dict[str, Callable[[Any], str]] = {
    "number": number_text,
    **{f"number{digits}": partial(number_text, digits=digits) for digits in (1, 2, 4)},
    "percent": percent_text,
    "error": error_name,
    "errors": error_list,
    "names": name_list,
    "and": join_words,
    "or": partial(join_words, last="or"),
    "excitation": excitation_requirement_text,
    "params": parameter_list,
}
"""Formats of values in a template, beside those of Python."""


class SentenceFormatter(Formatter):
    """Formatter of templates that knows ``FORMATS``."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value as text."""
        return FORMATS[format_spec](value) if format_spec in FORMATS else super().format_field(value, format_spec)


def template_sentence(template: Template, finding: Finding) -> str:
    """Return the sentence of a finding by a template."""
    if not isinstance(template, str):
        return template(finding)
    return SentenceFormatter().vformat(template, (), {**finding.values, "subject": finding.subject})
