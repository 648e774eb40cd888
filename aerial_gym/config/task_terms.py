"""Entries of a task file: observations, rewards, ends, commands and actions.

Each names a term of ``aerial_gym.task`` and gives its numbers; the term says which those are.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite

from aerial_gym.config import checks
from aerial_gym.config.checks import MAX_MADE

Params = Mapping[str, object]  # Numbers, texts and lists of them by name; the term's signature gives their types
Steps = int | tuple[int, int]  # Steps, or the fewest and the most, of which every episode draws one number


def _require_step_limits(config: object, name: str) -> None:
    low, high = fewest_and_most_steps(getattr(config, name))
    checks.require(config, name, 0 <= low <= high <= MAX_MADE, "must be >= 0, or the fewest and the most of them")


def fewest_and_most_steps(steps: Steps) -> tuple[int, int]:
    """Return the fewest and the most steps."""
    return (steps, steps) if isinstance(steps, int) else steps


FAULTS = ("lost", "jump")  # Kinds of sensor faults


@dataclass(frozen=True, kw_only=True)
class FaultCfg:
    """A fault of a sensor that begins at a moment of each episode's own: all terms that name it have it at once."""

    how: str
    """``lost``: the terms show their ``dropout_value``; ``jump``: an offset is added, drawn for each entry and episode, as
    where a satellite receiver takes an echo for the signal."""

    begin_steps: Steps
    """Environment step of the episode at which it begins, >= 0; two numbers: each episode draws one from the first to the
    second."""

    duration_steps: Steps  # Duration in steps, likewise
    size: float = 0.0  # Largest offset of a jump, in the unit of the term, > 0; each entry's is uniform within +- it
    share: float = 1.0  # Of the episodes that have it, > 0 and <= 1

    def __post_init__(self) -> None:
        checks.require_choice(self, "how", FAULTS)
        _require_step_limits(self, "begin_steps")
        _require_step_limits(self, "duration_steps")
        holds = (self.how == "jump") == (0.0 < self.size < inf)
        checks.require(self, "size", holds, "must be > 0 and finite of a jump, and 0 of others")
        checks.require(self, "share", 0.0 < self.share <= 1.0, "must be > 0 and <= 1")


@dataclass(frozen=True, kw_only=True)
class ObservationCfg:
    """One term of a group of observations: noise, dropout, fault, then delay, history and scale, in this order."""

    term: str  # Name in `aerial_gym.task.OBSERVATIONS`, or a key of the GTD or a task buffer itself
    params: Params = field(default_factory=dict)  # Numbers of the term by name
    noise_std: float = 0.0  # Standard deviation of white noise added to every entry, in the unit of the term, >= 0
    dropout: float = 0.0  # Probability that an entry is dropped, of each by itself at every step, 0 <= dropout < 1
    dropout_value: float = 0.0  # Value of a dropped or lost entry, in the unit of the term; finite

    hold_steps: int = 0
    """Steps for which a dropped entry shows what it held last, noise included, before it shows ``dropout_value``, >= 0. An
    entry dropped in the first observation of an episode held ``dropout_value``."""

    fault: str | None = None  # Name in `TaskCfg.faults`

    delay_steps: Steps = 0
    """Environment steps by which it is late, >= 0; two numbers: each episode draws one from the first to the second. Before
    so many steps have passed it shows the first observation of the episode."""

    history: int = 1  # Number of successive values in the observation, oldest first, >= 1
    scale: float = 1.0  # Factor on every entry, noise included; finite and not 0

    def __post_init__(self) -> None:
        checks.require_not_negative(self, "noise_std")
        checks.require(self, "dropout", 0.0 <= self.dropout < 1.0, "must be a probability, 0 <= dropout < 1")
        checks.require_finite(self, "dropout_value")
        holds = self.hold_steps == 0 or (self.hold_steps > 0 and self.dropout > 0.0)
        checks.require(self, "hold_steps", holds, "must be >= 0, and needs a dropout: nothing else is held")
        _require_step_limits(self, "delay_steps")
        checks.require_count(self, "history", most=MAX_MADE)
        checks.require(self, "scale", isfinite(self.scale) and self.scale != 0.0, "must be finite and not 0")


IMAGE_TYPES = ("uint8", "float16", "float32")  # Types in which an image can be observed


@dataclass(frozen=True, kw_only=True)
class ImageCfg:
    """A raw image among the observations."""

    key: str = "depth_range_pixels"  # Of the GTD, (E, S, H, W) or (E, S, H, W, K)
    dtype: str = "uint8"  # `uint8`: 0 to 255; `float16`, `float32`: 0 to 1
    largest: float | None = None  # Image value of 255 or 1, in its unit, > 0; that of its range sensor if not given
    history: int = 1  # Number of successive images, oldest first, the axis before the sensors, >= 1

    def __post_init__(self) -> None:
        checks.require_choice(self, "dtype", IMAGE_TYPES)
        checks.require_positive(self, "largest")
        checks.require_count(self, "history", most=MAX_MADE)


@dataclass(frozen=True, kw_only=True)
class RewardCfg:
    """One term of the reward: ``(weight + difficulty_weight c) value (sum of the terms in times)``, c the difficulty."""

    term: str  # Name in `aerial_gym.task.REWARDS`
    params: Params = field(default_factory=dict)  # Numbers of the term by name
    weight: float = 1.0  # Finite
    difficulty_weight: float = 0.0  # Added to the weight at the highest level, a share of it before; finite
    times: tuple[str, ...] = ()  # Names of reward terms without factors whose sum multiplies this term; none: 1

    def __post_init__(self) -> None:
        checks.require_float32(self, "weight", "difficulty_weight")


@dataclass(frozen=True, kw_only=True)
class EndRewardCfg:
    """Reward of an end: ``value + difficulty_value c``, c the difficulty."""

    value: float  # Finite
    difficulty_value: float = 0.0  # Added to the value at the highest level, a share of it before; finite
    how: str = "replace"  # `replace`: the reward of that step is this alone; `add`: it comes on top

    def __post_init__(self) -> None:
        checks.require_float32(self, "value", "difficulty_value")
        checks.require_choice(self, "how", ("replace", "add"))


KINDS = ("crash", "success", "time_out")  # Kinds of episode ends
WHENS = ("now", "counts", "at_end")  # Consequences of a true condition


@dataclass(frozen=True, kw_only=True)
class TerminationCfg:
    """A condition that ends episodes, and the kind of that end."""

    term: str  # Name in `aerial_gym.task.TERMINATIONS`
    params: Params = field(default_factory=dict)  # Numbers of the term by name
    kind: str  # `crash`, `success` or `time_out`; a crash goes before a success in the same step

    when: str = "now"
    """``now``: the episode ends where it is true. Of a success also ``counts``: the episode goes on, and ends as a success
    whenever that was, unless it crashes; and ``at_end``: only what is true at the end counts."""

    bootstrap: bool | None = None
    """Whether the return is taken to go on after such an end (``truncated``), or not (``terminated``); None: only that of
    a ``time_out`` goes on."""

    def __post_init__(self) -> None:
        checks.require_choice(self, "kind", KINDS)
        checks.require_choice(self, "when", WHENS)
        checks.require_choice(self, "vehicles", ("", "all", "any"))
        now = self.when == "now"
        checks.require(self, "when", now or self.kind == "success", f"only for kind success; a {self.kind} ends now")
        rule = f"a success that {self.when} ends nothing. Leave it out"
        checks.require(self, "bootstrap", now or self.bootstrap is None, rule)

    vehicles: str = field(default="", repr=False)  # a saved state has the digest of the repr
    """Vehicles of an environment with ``reset_together`` for which it must be true: ``any`` or ``all``; empty for ``all`` of
    a success, and ``any`` of others."""

    @property
    def needs_all(self) -> bool:
        """Whether it must be true for all vehicles of an environment."""
        return self.vehicles == "all" or (not self.vehicles and self.kind == "success")

    @property
    def bootstraps(self) -> bool:
        """Whether the return is taken to go on after it."""
        return self.kind == "time_out" if self.bootstrap is None else self.bootstrap


@dataclass(frozen=True, kw_only=True)
class CommandCfg:
    """Command generator of a task: a point, points, a trajectory, gates."""

    generator: str  # Name in `aerial_gym.task.COMMANDS`
    params: Params = field(default_factory=dict)  # Numbers of the generator by name


@dataclass(frozen=True, kw_only=True)
class ActionCfg:
    """Conversion of actions to commands: transform, delay, filter and noise."""

    transform: str = "direct"  # Name in `aerial_gym.task.ACTIONS`
    params: Params = field(default_factory=dict)  # Numbers of the transform by name

    delay_steps: Steps = 0
    """Environment steps by which the command is late, >= 0; two numbers: each episode draws one from the first to the
    second. Before so many steps have passed the first command of the episode holds."""

    filter_time_s: float = 0.0
    """Time constant of a first-order low pass of the delayed command [s], >= 0; 0 is none. It begins at the first command."""

    noise_std: float = 0.0
    """Standard deviation of white noise on every entry of the command that the controller takes, drawn in each step, in the
    units of the command, >= 0."""

    def __post_init__(self) -> None:
        _require_step_limits(self, "delay_steps")
        checks.require_not_negative(self, "noise_std", "filter_time_s")
