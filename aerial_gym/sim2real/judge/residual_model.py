"""Learned residual of flights without a named cause, judged on flights that it has not seen. Letters: C channels."""

from dataclasses import replace

from aerial_gym.errors import ConfigError
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.physics.model import check_effect_on_rotors
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.learned import ResidualFit, add_test_shares, leave_out_flights, train_residual
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.identify.stages import LoopSetup
from aerial_gym.sim2real.judge.outcome import BETTER, channel_outcomes
from aerial_gym.sim2real.predict.model_params import ModelParams


def can_learn_residual(declared: LoopSetup) -> bool:
    """Return whether a residual can be learned without being asked: for rotors that its law allows, and not twice."""
    try:
        check_effect_on_rotors(LearnedResidual, declared.robot.rotor_traits)
    except ConfigError:
        return False
    return declared.params.learned is None


def fit_residual(
    declared: LoopSetup,
    selection: SelectionResult,
    model: ModelParams,
    floor: Array | None,
    *,
    seed: int,
) -> ResidualFit:
    """Return a residual learned on the training flights; it is kept only if it improves flights that it has not seen.

    Both left-out training flights and test flights count. On these some channel must get better and none materially worse.
    """
    tested = declared.test
    left_out = leave_out_flights(declared.train, selection.weights, selection.criteria, selection.tolerated)
    trained = train_residual(declared.train, model, left_out, seed=seed)
    if trained.effect is None:
        return trained
    models = model, replace(model, learned=trained.effect)
    outcomes = channel_outcomes(tested, models, least=selection.criteria.material)
    harm = [
        Finding("channel_worse", one.quantity, {"share": one.rise.value}) for one in outcomes if one.is_materially_worse
    ]
    if not any(one.state == BETTER for one in outcomes):
        harm.append(Finding("gain_small", "", {"share": max(0.0, *(-one.rise.value for one in outcomes))}))
    if harm:
        return replace(trained, cfg=None, objections=tuple(harm))
    return add_test_shares(trained, tested, (declared.params, model), floor)
