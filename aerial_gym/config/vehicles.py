"""Vehicles of an environment: an entry of ``robots:`` in an environment file, or of ``build_env(robots=[...])``."""

from dataclasses import dataclass

from aerial_gym.config import checks


@dataclass(frozen=True, kw_only=True)
class VehiclesCfg:
    """Vehicles of one kind: robot and controller."""

    name: str  # Registered robot, or a robot file
    count: int = 1  # Vehicles in every environment, >= 1
    controller: str = ""  # Registered controller; empty for that of the call
    kind: str = ""  # Name of the kind; empty for the name of the robot. Two kinds have different names

    def __post_init__(self) -> None:
        checks.require(self, "name", bool(self.name), "must not be empty")
        checks.require_count(self, "count", most=checks.MAX_MADE)
