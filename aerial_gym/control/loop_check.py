"""The stability check of a robot under a controller before flight: it refuses, warns or passes.

It refuses a loop that does not return to hover from disturbances: an unstable one, or one with so small a gain margin that
rotor limits destabilise it. It warns of an unstable loop that returns nevertheless, as with limit cycles, and of a stable one
that effects of the robot file push farther than ``HOVER_RANGE`` from its setpoint.
"""

import logging
from math import log

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.gains import GAINS, has_explicit_gains, select_explicit_gains
from aerial_gym.control.hover import DISTURBANCE, HOVER_RANGE, HOVER_SPAN, trim_axes
from aerial_gym.control.laws import LAWS
from aerial_gym.control.linear_loop import AXES
from aerial_gym.control.stability import TURNS, ClosedLoop, HoverResult, are_stable
from aerial_gym.errors import ConfigError

_log = logging.getLogger(__name__)

REMEDY = (
    "Take a controller that integrates the error (px4_position_control, px4_velocity_control, crazyflie_lee_control), or raise "
    "position_frequency (control:). If only mass, centre of mass or rotors differ, set effectiveness: actual (control:)"
)
"""Remedy for the steady error of a law without integrator."""

SLOW_REMEDY = "Give its integrators more gain, or let a task begin when they have settled"
"""Remedy for a slow integrator."""


def check_closed_loop(
    robot: RobotCfg, controller: ControllerCfg, *, gravity: float, dt: float, integrator: str, names: tuple[str, str],
    randomize: Randomize | None = None,
) -> None:  # fmt: skip
    """Refuse a robot that does not hover under its controller at this time step, and warn of a poor hover.

    The check covers derived gains, gains of robot files and registered controllers, and laws of other packages that state
    their ``trim`` (``control.hover``). ``ControllerCfg.if_unstable`` turns the refusal into a warning, for example to
    reproduce published results.

    Args:
        gravity: Downward acceleration of free fall [m/s²].
        dt: Time step [s].
        names: Names of robot and controller for messages.
        randomize: Ranges of draws by name; the loop must also be stable at the ends of its gains.

    Raises:
        ConfigError: If the vehicle cannot hover, or the loop is refused.
    """
    axes = trim_axes(controller)
    if axes is None:
        _log.warning(
            f"law {controller.law!r}: states no trim, so its loop is not checked. Give its class the attribute trim, the axes "
            f"that it controls of {' '.join(AXES)}; empty for none"
        )
    if not axes or (gravity == 0.0 and controller.law not in LAWS):
        return
    loop = ClosedLoop(
        robot,
        controller,
        gravity=gravity,
        integrator=integrator,
        names=names,
        drawn=ranges_of_drawn_gains(randomize or {}),
    )
    subject = f"robot {names[0]} with controller {names[1]}"
    if vain := _uncontrollable_axes(loop.idle, controller, robot):
        refuse_or_warn(
            controller,
            f"{subject}: the explicit gains control {vain}, but its rotors give no torque there, "
            f"and the lasting error hides the others. Give attitude gains of 0 about {vain}, or leave them out",
        )
    subject, hover = f"{subject} at dt = {dt:g} s", loop.hover(dt)
    if hover.is_lost or not hover.stable:
        source, advice = _gain_source(controller, robot), _remedy_of_instability(loop, controller, robot, dt)
        fault = f"{subject} {fault_of_unstable_loop(hover, dt)}, with {source}. {advice}"
        if hover.is_lost:
            refuse_or_warn(controller, fault)
        else:
            _log.warning(
                f"{fault}. Flown for {HOVER_SPAN:g} s from disturbances it comes back within {hover.flown:.2g} m"
            )
    elif not loop.is_stable(dt):
        ends = ", ".join(f"gains.{name}" for name in loop.drawn)
        growth, span = max(loop.spectral_radii(dt)), _sentence_on_stable_dt(loop, dt)
        refuse_or_warn(
            controller,
            f"{subject} is unstable with gains at the ends of what is drawn of {ends}: a disturbance grows by a factor of "
            f"{growth:.3g} in each step. {span}Narrow these ranges (randomize:)",
        )
    elif not hover.is_within_range:
        effects = ", ".join(robot.effects) or "none"
        _log.warning(
            f"{subject} {hover_error_text(hover)}, as its law does not know of its effects ({effects}). {hover_remedy(hover)}"
        )
    elif _log.isEnabledFor(logging.INFO) and not loop.is_stable_with_margin(dt):
        _log.info(
            f"{subject} has a gain margin of less than 6 dB. {_remedy_of_instability(loop, controller, robot, dt)}"
        )


def hover_error_text(hover: HoverResult) -> str:
    """Return the hover error of a vehicle, as the predicate of a sentence."""
    speed, away = (max(map(abs, part)) for part in (hover.drift, hover.offset))
    if speed * HOVER_SPAN > HOVER_RANGE:
        return f"drifts at {_format_vector(hover.drift)} m/s"
    if away > HOVER_RANGE:
        return f"rests {_format_vector(hover.offset)} m from its setpoint"
    return (
        f"is up to {hover.distance:.2g} m from its setpoint in the first {HOVER_SPAN:g} s, until its integrators settle"
    )


def _format_vector(numbers: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{number:+.2g}" if abs(number) > 1e-3 else "0" for number in numbers) + ")"


def refuse_or_warn(controller: ControllerCfg, message: str) -> None:
    """Raise ``ConfigError`` with a message, or warn if ``ControllerCfg.if_unstable`` is ``warn``."""
    if controller.if_unstable == "refuse":
        raise ConfigError(message)
    _log.warning(message)


def hover_remedy(hover: HoverResult) -> str:
    """Return the remedy for a vehicle that hovers beside its setpoint."""
    return SLOW_REMEDY if max(map(abs, (*hover.offset, *hover.drift))) < 0.01 else REMEDY


def fault_of_unstable_loop(hover: HoverResult, dt: float) -> str:
    """Return the fault of an unstable loop at a time step [s], as the predicate of a sentence."""
    if hover.stable:
        return f"is nearly unstable: from starts with {DISTURBANCE[2]:g} m/s and {DISTURBANCE[3]:g} rad/s it does not come back"
    if are_stable([hover.growth]):
        return "comes to no rest: its law asks for more thrust or tilt than there is"
    span = dt * log(10.0) / log(hover.growth)
    return f"is unstable: a disturbance at hover grows by a factor of {hover.growth:.6g} in each step, tenfold in {span:.2g} s"


def _uncontrollable_axes(idle: list[str], controller: ControllerCfg, robot: RobotCfg) -> str:
    """Return the axes with explicit attitude gains but without rotor torque; empty if there are none."""
    own = controller.autopilot or controller.law not in LAWS
    explicit = None if own else select_explicit_gains(controller, robot.control)
    return "" if explicit is None else " and ".join(name for name in idle if explicit.attitude[TURNS.index(name)] > 0.0)


def _gain_source(controller: ControllerCfg, robot: RobotCfg) -> str:
    if controller.law not in LAWS:
        return "its own gains"
    explicit = has_explicit_gains(controller, robot.control)
    return "the explicit gains given" if explicit else "its frequencies and damping"


def _remedy_of_instability(loop: ClosedLoop, controller: ControllerCfg, robot: RobotCfg, dt: float) -> str:
    """Return the remedies of an unstable loop as sentences: the largest stable time step, and changes of gains."""
    late = "shorten the dead time (effects: actuation_delay), " if loop.delay else ""
    if controller.law not in LAWS:
        return (
            f"{_sentence_on_stable_dt(loop, dt)}To fly it, {late}lower the gains in the code of law {controller.law!r}"
        )
    if not has_explicit_gains(controller, robot.control):
        return f"{_sentence_on_stable_dt(loop, dt)}To fly it, {late}lower the frequencies (control:)"
    return (
        f"{_sentence_on_stable_dt(loop, dt)}To fly it, {late}lower them, or leave them out to have them "
        'derived (lee_*, pid_*); dataclasses.replace(controller, if_unstable="warn") flies them as they are'
    )


def _sentence_on_stable_dt(loop: ClosedLoop, dt: float) -> str:
    """Return a sentence about the largest stable time step; empty for a controller with fixed rates."""
    try:
        best = loop.largest_dt_with_margin(dt)
    except ConfigError:
        return ""
    if best is None:
        return "No dt has a gain margin of 6 dB. "
    return f"The largest dt with a gain margin of 6 dB is {best:.3g} s. "


def ranges_of_drawn_gains(randomize: Randomize) -> dict[str, RandomizeCfg]:
    """Return the ranges of randomised gains, by their names without ``gains.``."""
    return {name: randomize[f"gains.{name}"] for name in GAINS if f"gains.{name}" in randomize}
