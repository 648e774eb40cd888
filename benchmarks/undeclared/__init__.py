"""Truth plant: flight logs of a quadrotor in which a physical effect is present but not declared.

Referee of the system identification: shares no code with the package it judges. See README.md for the equations.
"""

from benchmarks.undeclared.cases import CaseFiles, make_case
from benchmarks.undeclared.effects import EFFECTS, FEATURES, SIZES, UNKNOWN
from benchmarks.undeclared.sensors import LOGGED, TRACKED
from benchmarks.undeclared.surroundings import PlantFailure

__all__ = ["EFFECTS", "FEATURES", "LOGGED", "SIZES", "TRACKED", "UNKNOWN", "CaseFiles", "PlantFailure", "make_case"]
