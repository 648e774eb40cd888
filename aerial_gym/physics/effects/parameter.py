"""Parameters of effects: name, unit, physical bounds and scale."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect."""

    name: str  # Short name, as in robot files and verdicts
    unit: str  # SI unit
    low: float  # Lowest value that is physically possible
    high: float  # Highest value that is physically possible
    scale: float  # A change that one would call moderate: the step of numerical derivatives and fits
    meaning: str  # One line
    neutral: float = 0.0  # Value with which the robot behaves as declared
    kind: Literal["number", "rotor", "convention"] = "number"
    """A number that a fit may change, the number of a rotor (1 to R), or a convention that a fit keeps."""
