"""Learned residual in a robot file: a small network for force and torque that no named effect explains.

Letter: D = 7 inputs: velocity of the centre of mass through the air [m/s] and angular velocity [rad/s], body axes, and the mean
of the squared rotor speeds [rad²/s²]. Outputs: force [N] and torque about the centre of mass [N m], body axes.
"""

from dataclasses import dataclass

from aerial_gym.config.checks import NO_SOURCE, require, require_finite, require_ordered
from aerial_gym.errors import ConfigError

NUM_INPUTS, NUM_OUTPUTS = 7, 6

Row = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class LayerCfg:
    """One fully connected layer, ``W x + b``."""

    weights: tuple[Row, ...]  # W, one row per output
    bias: Row  # b, one number per output

    def __post_init__(self) -> None:
        widths = {len(row) for row in self.weights}
        if len(widths) != 1 or 0 in widths or len(self.bias) != len(self.weights):
            raise ConfigError(
                f"LayerCfg: {len(self.weights)} rows of weights with {sorted(widths)} numbers and {len(self.bias)} of bias: "
                "needs rows of one length, and a bias for each"
            )
        require_finite(self, "weights", "bias")

    @property
    def num_inputs(self) -> int:
        """Length of x."""
        return len(self.weights[0])


@dataclass(frozen=True, kw_only=True)
class LearnedResidualCfg:
    """The network, and where its training data end; made by ``aerial-gym close-loop --learn-residual``."""

    low: Row  # Least inputs [m/s, rad/s, rad²/s²], (D,): inputs are held within the training data
    high: Row  # Greatest inputs, (D,)
    centre: Row  # Subtracted from inputs, (D,)
    scale: Row  # Inputs are divided by it, > 0, (D,)

    whitening: tuple[Row, ...]
    """(D, D). Of standardised inputs x, |whitening x| = 1 where the training data end, 2 where the output is zero."""

    hidden: tuple[LayerCfg, ...]  # Layers with tanh, from standardised inputs on; at least one
    output: LayerCfg  # The last layer, to force [N] and torque [N m], (6,)
    limit: Row  # Largest magnitude of each output [N, N m], >= 0, (6,)
    source: str = NO_SOURCE  # Flights that it was trained on

    def __post_init__(self) -> None:
        self._check_shapes()
        require_finite(self, "low", "high", "centre", "scale", "whitening", "limit")
        require_ordered(self, "low", "high")
        require(self, "scale", min(self.scale) > 0.0, "must be > 0")
        require(self, "limit", min(self.limit) >= 0.0, "must be >= 0")

    def _check_shapes(self) -> None:
        width = NUM_INPUTS
        for name in ("low", "high", "centre", "scale", "whitening"):
            require(self, name, len(getattr(self, name)) == width, f"needs {width} entries, one per input")
        holds = all(len(row) == width for row in self.whitening)
        require(self, "whitening", holds, f"needs {width} rows of {width} numbers, one per input")
        if len(self.limit) != NUM_OUTPUTS or len(self.output.bias) != NUM_OUTPUTS:
            raise ConfigError(
                f"LearnedResidualCfg: {len(self.output.bias)} outputs with {len(self.limit)} limits: "
                f"needs {NUM_OUTPUTS} of each, force and torque"
            )
        require(self, "hidden", bool(self.hidden), "needs at least one layer")
        for place, layer in enumerate((*self.hidden, self.output)):
            if layer.num_inputs != width:
                raise ConfigError(
                    f"LearnedResidualCfg: layer {place + 1} takes {layer.num_inputs} numbers, the one before gives {width}"
                )
            width = len(layer.bias)
