"""When the levels of a controller run, in physics steps: rates become whole numbers of them, or are refused."""

from dataclasses import dataclass

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.errors import ConfigError

WHOLE = 1e-6
"""How far a ratio may be from a whole number, as a share: rates and time steps are decimal fractions."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Physics steps between the runs of each level, and until a message has come through."""

    dt: float  # Physics step [s]
    law: int  # Between runs of the law; a multiple of `loop`
    loop: int  # Between runs of the rate loop; that of the law where there is none
    delay: int  # From the law to the rate loop
    action_delay: int  # To the law

    @property
    def setpoint_slots(self) -> int:
        """How many wishes of the law must be remembered."""
        if self.delay:
            return self.delay // self.law + 2
        return int(self.law > self.loop)

    @property
    def action_slots(self) -> int:
        """How many actions must be remembered."""
        return self.action_delay + 1 if self.action_delay else 0

    @property
    def extra_lag(self) -> float:
        """By which the law sees the answer of the rate loop late, beyond one run of the loop [s]."""
        return (self.law - self.loop + self.delay) * self.dt


def timing_of(cfg: ControllerCfg, dt: float) -> Timing:
    """Return when the levels of a controller run at physics steps of ``dt`` [s].

    Raises:
        ConfigError: If no whole number of steps fits into a period or a delay, or the law runs between runs of its loop.
    """
    inner = cfg.inner
    loop_hz = None if inner is None else inner.rate_hz
    loop = 1 if loop_hz is None else _steps(f"{type(inner).__name__}.rate_hz", loop_hz, "Hz", 1.0 / loop_hz, dt)
    law = loop if cfg.rate_hz is None else _steps("ControllerCfg.rate_hz", cfg.rate_hz, "Hz", 1.0 / cfg.rate_hz, dt)
    if inner is None:
        loop = law
    if law % loop:
        raise ConfigError(
            f"ControllerCfg.rate_hz = {cfg.rate_hz!r}: the rate loop runs at {loop_hz} Hz, which must be a multiple of it"
        )
    delays = {
        name: _steps(f"ControllerCfg.{name}", value, "s", value, dt) if value > 0.0 else 0
        for name, value in (("delay", cfg.delay), ("action_delay", cfg.action_delay))
    }
    return Timing(dt=dt, law=law, loop=loop, **delays)


def remembers(cfg: ControllerCfg) -> bool:
    """Return whether a controller needs memory."""
    return cfg.inner is not None or cfg.autopilot is not None or cfg.rate_hz is not None or cfg.action_delay > 0.0


def _steps(name: str, value: float, unit: str, span: float, dt: float) -> int:
    ratio = span / dt
    if round(ratio) < 1 or abs(ratio - round(ratio)) > WHOLE * ratio:
        raise ConfigError(
            f"{name} = {value:g} {unit}: {span:g} s are {ratio:.6g} physics steps of {dt:g} s, but must be a whole number. "
            f"Take another time step, or {_nearest(unit, max(round(ratio), 1) * dt)}"
        )
    return round(ratio)


def _nearest(unit: str, span: float) -> str:
    return f"{1.0 / span:.6g} Hz" if unit == "Hz" else f"{span:g} s"
