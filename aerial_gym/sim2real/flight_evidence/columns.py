"""Columns of the evidence of a flight: the parameters of all candidate effects, then the tolerances.

They depend on the robot file alone, so the sums of its flights add. Letters: K columns.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import LoadEffect
from aerial_gym.sim2real.identify.candidates.library import has_several_starts, law_relatives, linearisation_points
from aerial_gym.sim2real.identify.candidates.testable import finding_on_refused_effect
from aerial_gym.sim2real.identify.evidence.laplace import Candidates
from aerial_gym.sim2real.identify.least_squares.derivatives import is_continuous_parameter
from aerial_gym.sim2real.identify.selection.select import default_effects
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from aerial_gym.sim2real.predict.tolerances import Tolerances


@dataclass(frozen=True, kw_only=True)
class EvidenceColumn:
    """One parameter of an effect, in units of its scale from neutral, or one tolerance, in standard deviations."""

    effect: str  # Empty for a tolerance
    parameter: str  # Name of the parameter or the tolerance
    rotor: int  # Number of the rotor from 1 for an effect on one rotor, else 0
    start: int  # Number of the start from 1, 0 for an effect with one start
    scale: float  # Physical size of one unit
    neutral: float  # Value at which it changes nothing
    low: float  # Lowest value, in physical units
    high: float  # Highest value, in physical units


def candidate_points(robot: RobotCfg) -> list[tuple[str, ModelParams]]:
    """Return each default candidate effect that a robot admits with the model of its linearisation, once per start."""
    declared, wanted = params_from_robot(robot), default_effects()
    skipped = [name for name in EFFECTS if name not in wanted or finding_on_refused_effect(name, robot)]
    return linearisation_points(declared, declared, (), skipped, robot)


def continuous_places(effect: str) -> list[int]:
    """Return the indices of an effect's continuous parameters."""
    return [k for k in range(len(EFFECTS.get(effect).parameters)) if is_continuous_parameter(effect, k)]


def evidence_columns(robot: RobotCfg, tolerances: Tolerances) -> tuple[EvidenceColumn, ...]:
    """Return the K columns of a robot: parameters in the order of ``candidate_points``, then the tolerances."""
    columns, starts = list[EvidenceColumn](), dict[str, int]()
    for name, params in candidate_points(robot):
        effect, values = EFFECTS.get(name), params.effects[name].copy()
        if isinstance(effect, LoadEffect):  # linearised with a load, whose mass is 0 where it changes nothing
            values[0] = effect.neutral(robot)[0]
        rotor = round(float(values[0])) if effect.parameters[0].kind == "rotor" else 0
        starts[name] = starts.get(name, 0) + 1
        start = starts[name] if has_several_starts(name, robot) and not rotor else 0
        for k in continuous_places(name):
            low, high = effect.bounds(robot)[k]
            parameter = effect.parameters[k]
            unit = {"scale": parameter.scale, "neutral": float(values[k]), "low": low, "high": high}
            columns.append(EvidenceColumn(effect=name, parameter=parameter.name, rotor=rotor, start=start, **unit))
    names, sizes = tolerances.names(robot.num_rotors), tolerances.standard_deviations(robot.num_rotors).tolist()
    for name, size in zip(names, sizes, strict=True):
        if size:
            unit = {"scale": size, "neutral": 0.0, "low": -np.inf, "high": np.inf}
            columns.append(EvidenceColumn(effect="", parameter=name, rotor=0, start=0, **unit))
    return tuple(columns)


def candidates_of_columns(columns: Sequence[EvidenceColumn]) -> Candidates:
    """Return the candidates that the columns form: one for each effect, rotor and start."""
    owners = [(one.effect, one.rotor, one.start) for one in columns]
    groups = {owner: np.array(list(places)) for owner, places in groupby(range(len(owners)), owners.__getitem__)}
    tolerances = groups.pop(("", 0, 0))
    names = tuple(name for name, _, _ in groups)
    return Candidates(
        columns=tuple(groups.values()),
        tolerances=tolerances,
        low=np.array([(one.low - one.neutral) / one.scale if one.effect else -np.inf for one in columns]),
        high=np.array([(one.high - one.neutral) / one.scale if one.effect else np.inf for one in columns]),
        exclusive=names,
        apart=frozenset(frozenset((name, other)) for name in set(names) for other in law_relatives(name)),
    )
