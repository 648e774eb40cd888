"""Named winds and sensor errors that explain less of the residual than stays unexplained: the unknown cause is larger.

Letters: C channels.
"""

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.residual_excess import ResidualExcess, channel_rms, excess_power
from aerial_gym.sim2real.predict.predictor import Predictor

OUTSIDE = ("environment", "sensor")  # What an effect acts on, if it is no value of the vehicle


def effects_below_remainder(
    train: Predictor, selection: SelectionResult, unexplained: ResidualExcess
) -> dict[str, Finding]:
    """Return the named winds and sensor errors that no channel supports, each with its finding.

    Wind and sensor errors can take the shape of an unknown cause. A value of the vehicle cannot so easily: a moment of inertia
    is real even where unsteady air leaves a larger residual. An explained channel supports an effect. Any other channel does
    if the effect removes more of its mean square on the training flights than remains above the noise floor. The gain in
    log likelihood of these channels must reach ``LEAST_SCORE``.
    """
    rows, weight = sum(time.size for time in train.times), selection.weights.weight
    power = channel_rms(train.residuals(selection.named.model_with_deviations)) ** 2
    open_channels = np.array([channel.name in unexplained.channels for channel in train.channels])
    remainder = open_channels * excess_power(np.sqrt(power), unexplained.floor)
    results = {}
    names = [name for name in selection.effect_names if EFFECTS.get(name).acts_on in OUTSIDE]
    for name in names if open_channels.any() else ():
        removed = channel_rms(train.residuals(selection.without[name].model_with_deviations)) ** 2 - power
        gain = 0.5 * rows * float(weight @ np.where(removed > remainder, removed, 0.0))
        if gain < LEAST_SCORE * selection.best.parameter_overdispersion:
            results[name] = Finding("remainder_larger", name, {"channels": list(unexplained.channels)})
    return results
