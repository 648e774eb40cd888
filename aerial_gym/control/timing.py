"""Timing of the levels of a controller in whole physics steps; other rates are refused."""

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics.law_memory import Timing

WHOLE = 1e-6  # Relative tolerance of whole ratios, because rates and time steps are decimal fractions


def make_timing(cfg: ControllerCfg, dt: float) -> Timing:
    """Return the timing of a controller's levels at physics steps of ``dt`` [s].

    Raises:
        ConfigError: If a period or delay is not a whole number of steps, or the law's period not one of its loop's.
    """
    inner = cfg.rate_settings
    loop_hz = None if inner is None else inner.rate_hz
    loop = 1 if loop_hz is None else _whole_steps(f"{type(inner).__name__}.rate_hz", loop_hz, "Hz", 1.0 / loop_hz, dt)
    law = (
        loop if cfg.rate_hz is None else _whole_steps("ControllerCfg.rate_hz", cfg.rate_hz, "Hz", 1.0 / cfg.rate_hz, dt)
    )
    if inner is None:
        loop = law
    if law % loop:
        raise ConfigError(
            f"ControllerCfg.rate_hz = {cfg.rate_hz!r}: the rate loop runs at {loop_hz} Hz, which must be a multiple of it"
        )
    delays = {
        name: _whole_steps(f"ControllerCfg.{name}", value, "s", value, dt) if value > 0.0 else 0
        for name, value in (("delay", cfg.delay), ("action_delay", cfg.action_delay))
    }
    return Timing(dt=dt, law=law, loop=loop, **delays)


def has_memory(cfg: ControllerCfg) -> bool:
    """Return whether a controller needs memory."""
    return (
        cfg.rate_settings is not None or cfg.autopilot is not None or cfg.rate_hz is not None or cfg.action_delay > 0.0
    )


def _whole_steps(name: str, value: float, unit: str, span: float, dt: float) -> int:
    ratio = span / dt
    if round(ratio) < 1 or abs(ratio - round(ratio)) > WHOLE * ratio:
        raise ConfigError(
            f"{name} = {value:g} {unit}: {span:g} s are {ratio:.6g} physics steps of {dt:g} s, but must be a whole number. "
            f"Take another time step, or {_nearest_setting(unit, max(round(ratio), 1) * dt)}"
        )
    return round(ratio)


def _nearest_setting(unit: str, span: float) -> str:
    return f"{1.0 / span:.6g} Hz" if unit == "Hz" else f"{span:g} s"
