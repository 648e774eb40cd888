"""Test of effects on inertial sensors against the kinematic channels, which need no dynamics."""

from collections.abc import Iterable

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import ImuEffect
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import neutral_params
from aerial_gym.sim2real.identify.least_squares.moments import flight_of_rows, time_block_of_rows
from aerial_gym.sim2real.predict.channels import KINEMATIC
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import rise_with_interval


def effects_against_kinematics(
    predictor: Predictor, params: ModelParams, names: Iterable[str], declared: ModelParams
) -> dict[str, Finding]:
    """Return the effects on inertial sensors, among ``names``, that worsen a kinematic channel on the training flights.

    Such an effect stands in for an error of the dynamics. A channel is worse if the 95 % interval of its rise by the effect
    is above zero.
    """
    places = [k for k, channel in enumerate(predictor.channels) if channel.kind in KINEMATIC]
    results, group, flight = dict[str, Finding](), time_block_of_rows(predictor.times), flight_of_rows(predictor.times)
    for name in names:
        if not places or not isinstance(EFFECTS.get(name), ImuEffect):
            continue
        neutral = params.with_effect(name, neutral_params(name, declared, predictor.robot))
        residual, without = (np.concatenate(predictor.residuals(one))[:, places] for one in (params, neutral))
        rises = rise_with_interval(residual, without, group, flight)
        worst = max(range(len(places)), key=lambda k: rises[k].low)
        if rises[worst].low > 0.0:
            channel = predictor.channels[places[worst]].name
            results[name] = Finding("kinematics_disagree", name, {"channel": channel, "rise": rises[worst].value})
    return results
