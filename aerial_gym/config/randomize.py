"""Randomisation of quantities of a robot, its effects, sensors and gains: ``randomize:`` of robot, environment and
task files.

```yaml
randomize:
  body.mass: {low: 0.9, high: 1.1}                                  # a factor, uniform
  rotor.thrust_map: {each_rotor: true, distribution: normal, mean: 1.0, std: 0.03, low: 0.9, high: 1.1}
  effects.rotor_drag.dx: {how: value, low: 0.05, high: 0.2, distribution: log_uniform}
  body.com: {how: offset, low: [-0.01, -0.01, 0.0], high: [0.01, 0.01, 0.0]}
  effects.rotor_drag.dy: {how: value, distribution: normal, mean: 0.2, std: 0.02}
  effects.rotor_drag.dz: {how: value, distribution: normal, mean: 0.1, std: 0.03, correlation: {effects.rotor_drag.dy: -0.7}}
```
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite

from aerial_gym.config.checks import require, require_choice
from aerial_gym.errors import ConfigError

HOW = ("scale", "offset", "value")  # Kinds of draws: factor on the declared value, offset to it, or the value itself

DISTRIBUTIONS = ("uniform", "log_uniform", "normal", "integer")
"""Distributions. A normal one is truncated at ``low`` and ``high``, where they are given; an integer one draws whole
numbers from ``low`` to ``high``, all equally often."""


LARGEST_NORMAL = 5.4  # Largest normal draw by float32 shares of probability [standard deviations]


@dataclass(frozen=True, kw_only=True)
class RandomizeCfg:
    """Distribution of one quantity, drawn for each environment and episode."""

    how: str = "scale"  # One of `HOW`
    distribution: str = "uniform"  # One of `DISTRIBUTIONS`
    low: float | tuple[float, ...] | None = None  # Lowest draw, or of each component; unit of the quantity, or factor
    high: float | tuple[float, ...] | None = None  # Highest draw, likewise
    mean: float | tuple[float, ...] | None = None  # Of a normal distribution
    std: float | tuple[float, ...] | None = None  # Of a normal distribution, > 0
    each_rotor: bool = False  # Whether each rotor has a draw of its own; of `rotor.` and `mounts.*.` quantities
    keep_inertia: bool = False  # Whether a drawn `body.mass` leaves the inertia; else that grows with the mass

    correlation: Mapping[str, float] = field(default_factory=dict)
    """Of a normal distribution of one number: correlation, -1 to 1, with others of that kind by their names, each pair at one
    of the two. Together they are drawn from a joint normal distribution; ``low`` and ``high`` then clip what is beyond."""

    def __post_init__(self) -> None:
        require_choice(self, "how", HOW)
        require_choice(self, "distribution", DISTRIBUTIONS)
        normal, subject = self.distribution == "normal", f"a {self.distribution} distribution"
        needed, forbidden = (("mean", "std"), ()) if normal else (("low", "high"), ("mean", "std", "correlation"))
        for name in needed:
            require(self, name, getattr(self, name) is not None, f"{subject} needs {' and '.join(needed)}")
        for name in forbidden:
            require(self, name, not getattr(self, name), f"{subject} has none")
        holds = all(-1.0 <= value <= 1.0 for value in self.correlation.values())
        require(self, "correlation", holds, "must lie in -1 to 1")
        for numbers in self.component_distributions(max(self.component_counts())):
            self._check_component(*numbers)

    def _check_component(self, low: float, high: float, mean: float, std: float) -> None:
        normal, limits = self.distribution == "normal", f"with high = {self.high!r}"
        require(self, "low", low < high or (low == high and not normal), f"{limits} needs low <= high")
        require(self, "low", normal or (isfinite(low) and isfinite(high)), f"{limits} must be finite")
        if normal:
            rule = f"with std = {self.std!r} needs a finite mean and 0 < std < inf"
            require(self, "mean", isfinite(mean) and 0.0 < std < inf, rule)
            holds = low - 4.0 * std < mean < high + 4.0 * std
            rule = f"with std = {self.std!r} hardly anything lies in low = {self.low!r} to high = {self.high!r}"
            require(self, "mean", holds, rule)
        holds = self.distribution != "log_uniform" or low > 0.0
        require(self, "low", holds, "a log_uniform distribution needs 0 < low")
        holds = self.distribution != "integer" or (float(low).is_integer() and float(high).is_integer())
        require(self, "low", holds, f"{limits}: an integer distribution needs whole numbers")
        require(self, "low", self.how != "scale" or low >= 0.0, "a factor needs a lowest value >= 0 (how: scale)")

    def value_limits(self, name: str, declared: Sequence[float], *, spread: float = inf) -> list[tuple[float, float]]:
        """Return least and greatest value of each component; beyond ``spread`` standard deviations a normal one is cut off."""
        try:
            numbers = self.component_distributions(len(declared))
        except ConfigError as error:
            raise ConfigError(f"randomize: {name}: {error}") from None
        rows = []
        for value, (low, high, mean, std) in zip(declared, numbers, strict=True):
            if std > 0.0:
                low, high = max(low, mean - spread * std), min(high, mean + spread * std)
            ends = {"value": (low, high), "offset": (value + low, value + high)}.get(
                self.how, (value * low, value * high)
            )
            rows.append((min(ends), max(ends)))
        return rows

    def component_counts(self) -> set[int]:
        """Return the numbers of components that the fields have; 1 for single numbers."""
        given = (self.low, self.high, self.mean, self.std)
        return {len(value) if isinstance(value, tuple) else 1 for value in given if value is not None}

    def component_distributions(self, width: int) -> list[tuple[float, float, float, float]]:
        """Return low, high, mean and standard deviation of each of ``width`` components; 0 where there are none."""
        rows = []
        for name, missing in (("low", -inf), ("high", inf), ("mean", 0.0), ("std", 0.0)):
            value = getattr(self, name)
            value = missing if value is None else value
            row = value if isinstance(value, tuple) else (value,) * width
            if len(row) != width:
                raise ConfigError(f"RandomizeCfg.{name} = {value!r}: needs one number, or {width}")
            rows.append(row)
        return list(zip(*rows, strict=True))


Randomize = Mapping[str, RandomizeCfg]  # Distributions by the names of quantities
