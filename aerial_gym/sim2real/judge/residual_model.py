"""Learned residual of flights without a named cause. Letters: C channels."""

from aerial_gym.errors import ConfigError
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.physics.model import check_effect_on_rotors
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.learned import ResidualFit, add_test_shares, leave_out_flights, train_residual
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.identify.stages import LoopSetup
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.redeclare import deviations_beyond_tolerance


def can_learn_residual(declared: LoopSetup) -> bool:
    """Return whether a residual can be learned without being asked: for rotors that its law allows, and not twice."""
    try:
        check_effect_on_rotors(LearnedResidual, declared.robot.rotor_traits)
    except ConfigError:
        return False
    return declared.params.learned is None


def fit_residual(
    declared: LoopSetup, selection: SelectionResult, model: ModelParams, within: ModelParams, floor: Array | None, *,
    seed: int,
) -> ResidualFit:  # fmt: skip
    """Return a residual learned on the training flights, with its share of the error of the test flights.

    Cross-validation over the training flights decides whether it is kept; the test flights only report. It must also hold
    beside the best deviations ``within`` the tolerances, which need no network, unless flights contradict declared values.
    """
    left_out = leave_out_flights(declared.train, selection.weights, selection.criteria, selection.tolerated)
    assert within.deviation is not None
    if not deviations_beyond_tolerance(declared.tolerances, within.deviation, declared.robot):
        beyond = train_residual(declared.train, within, left_out, seed=seed)
        if beyond.cfg is None:
            return beyond
    trained = train_residual(declared.train, model, left_out, seed=seed)
    return add_test_shares(trained, declared.test, (declared.params, model), floor)
