"""Base class of the parameters of real autopilots."""

from dataclasses import fields
from math import inf
from typing import Any, ClassVar

from aerial_gym.config.checks import require


class AutopilotTuning:
    """Base of the parameters of an autopilot: dataclasses of finite numbers >= 0, where None stands for a derived value."""

    NOT_GAINS: ClassVar[frozenset[str]] = frozenset(("rate_hz", "source"))  # Fields that are no gains
    POSITIVE: ClassVar[frozenset[str]] = frozenset(("rate_hz",))  # Fields that are divided by
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            numbers = [
                each for each in (value if isinstance(value, tuple) else (value,)) if isinstance(each, (int, float))
            ]
            require(self, field.name, all(0.0 <= number < inf for number in numbers), "must be >= 0 and finite")
        for name in self.POSITIVE:
            require(self, name, getattr(self, name, None) != 0.0, "must be > 0")

    @property
    def has_explicit_gains(self) -> bool:
        """Whether any gain, limit or filter is not as the class has it: then the parameters are someone's tuning."""
        return any(getattr(self, f.name) != f.default for f in fields(self) if f.name not in self.NOT_GAINS)
