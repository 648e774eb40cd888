"""What flights say of a joint, whether its angle was logged or not."""

from dataclasses import dataclass

from aerial_gym.config.joint import SpringCfg
from aerial_gym.sim2real.plain import fields_of
from aerial_gym.sim2real.teststand.statistics import Estimate


@dataclass(frozen=True, kw_only=True)
class FoundJoint:
    """What flights say of a joint."""

    name: str
    changed: tuple[str, ...]
    """What of it differs from what is declared, by the 95 % intervals."""

    declared: dict[str, float]
    params: dict[str, Estimate]
    """By the names of ``SpringCfg``."""

    spring: SpringCfg
    """For the robot file."""

    @property
    def sentence(self) -> str:
        """What differs, in words."""
        told = [
            f"{name} {self.params[name].value:.3g} in place of {self.declared[name]:.3g}"
            for name in self.changed
            if name in self.params and name in self.declared
        ]
        return f"joint {self.name}: {', '.join(told) or ', '.join(self.changed)}"

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return fields_of(self, "name", "changed", "declared", "params")
