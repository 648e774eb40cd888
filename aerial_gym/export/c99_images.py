"""Image networks of a policy as C99: convolutions with stride 2, in work space of the caller's state.

Letters: C x H x W the shape of an image or of a layer's output.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import prod

from torch import Tensor, nn

from aerial_gym.errors import ConfigError
from aerial_gym.export.layout import Layout, ObservationImage
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.rl_training.policies.body import ImageNetwork

PIXELS = {"uint8": ("unsigned char", " / 255.0f"), "float32": ("float", "")}
"""C type of the pixels of an image dtype, and the conversion to a share."""

CONVOLVE = """
/* Kernel of 3 x 3, every second pixel, a border of zeros. */
static void convolve(const float *weight, const float *bias, int num_in, int rows, int columns, int num_out,
                     const float *in, float *out) {
    const int down = (rows + 1) / 2, right = (columns + 1) / 2;
    for (int o = 0; o < num_out; ++o) for (int r = 0; r < down; ++r) for (int c = 0; c < right; ++c) {
        float sum = bias[o];
        for (int i = 0; i < num_in; ++i) {
            float part = 0.0f;
            for (int y = 0; y < 3; ++y) for (int x = 0; x < 3; ++x) {
                const int row = 2 * r + y - 1, column = 2 * c + x - 1;
                if (row < 0 || row >= rows || column < 0 || column >= columns) continue;
                part += weight[((o * num_in + i) * 3 + y) * 3 + x] * in[(i * rows + row) * columns + column];
            }
            sum += part;
        }
        out[(o * down + r) * right + c] = activated(sum);
    }
}
"""


@dataclass(frozen=True, kw_only=True)
class ImageCode:
    """C code of image networks."""

    arrays: tuple[str, ...]  # Definitions of weights
    code: str  # Statements that leave the features of each image in `NAME_features`
    widths: dict[str, int]  # How many these are, by the key of the image
    work: int  # Numbers that the largest layer makes: the state holds twice as many


def image_parameters(layout: Layout) -> str:
    """Return the images among the parameters of the step, in order."""
    return "".join(f"const {_pixel_type(image)[0]} {image.key}[{prod(image.shape)}], " for image in layout.images)


def _pixel_type(image: ObservationImage) -> tuple[str, str]:
    if image.dtype not in PIXELS:
        raise ConfigError(
            f"image {image.key!r}: {image.dtype} has no type in C99. Export onnx or torchscript, or train with dtype "
            f"{' or '.join(PIXELS)}"
        )
    return PIXELS[image.dtype]


def image_comment(image: ObservationImage) -> str:
    """Return the header's comment on an image."""
    channels, rows, columns = image.shape
    written = "floor(255 share + 0.5)" if image.dtype == "uint8" else "the share itself"
    return (
        f" *   {image.key}: {channels} x {rows} x {columns} pixels, row by row from the top, each as a share of "
        f"{image.largest:g} {image.unit}, 1 at most,\n *     and {image.without:g} where it is negative; as {written}. "
        f"{image.meaning}\n"
    )


def image_code(policy: DeployablePolicy, layout: Layout, array: Callable[[str, Tensor], str]) -> ImageCode:
    """Return the C code of a policy's image networks; ``array`` defines a constant array of a name."""
    arrays: list[str] = []
    code: list[str] = []
    widths, work = {}, 0
    for image in layout.images:
        encoder, out = policy.policy.body.encoders[image.key], f"{image.key}_features"
        assert isinstance(encoder, ImageNetwork)
        layers = layer_code(encoder, image.shape, array, name=image.key, out=out)
        wide = widths[image.key] = layers.widths[image.key]
        arrays += layers.arrays
        code += [
            f"    for (int i = 0; i < {prod(image.shape)}; ++i) state->work[0][i] = {image.key}[i]{_pixel_type(image)[1]};",
            f"    float {out}[{wide}];",
            layers.code,
            f"    for (int i = 0; i < {wide}; ++i) {out}[i] = activated({out}[i]);",
        ]
        work = max(work, layers.work)
    return ImageCode(arrays=tuple(arrays), code="\n".join(code), widths=widths, work=work)


def layer_code(
    network: nn.Module, shape: tuple[int, int, int], array: Callable[[str, Tensor], str], *, name: str, out: str
) -> ImageCode:
    """Return the C code of convolutions and the final dense layer, without its activation.

    Args:
        shape: Of the image, in ``state->work[0]``.
        name: Prefix of the names of arrays and widths.
        out: Array that receives the last layer's output.
    """
    arrays, code, place, work, wide = [], [], 0, prod(shape), 0
    layers = [layer for layer in network.modules() if isinstance(layer, (nn.Conv2d, nn.Linear))]
    for number, layer in enumerate(layers):
        label, given = f"{name}_{number}", f"state->work[{place}]"
        assert layer.bias is not None
        arrays += [array(f"{label}_weight", layer.weight), array(f"{label}_bias", layer.bias)]
        if isinstance(layer, nn.Linear):
            wide = layer.out_features
            code.append(f"    dense({label}_weight, {label}_bias, {layer.in_features}, {wide}, {given}, {out});")
            continue
        code.append(
            f"    convolve({label}_weight, {label}_bias, {shape[0]}, {shape[1]}, {shape[2]}, {layer.out_channels}, "
            f"{given}, state->work[{1 - place}]);"
        )
        shape, place = (layer.out_channels, (shape[1] + 1) // 2, (shape[2] + 1) // 2), 1 - place
        work = max(work, prod(shape))
    return ImageCode(arrays=tuple(arrays), code="\n".join(code), widths={name: wide}, work=work)


def join_code(policy: DeployablePolicy, widths: dict[str, int]) -> str:
    """Return statements that put vectors and features side by side in ``joined``, in the order of the policy."""
    counts, first, place = {key: shape[0] for key, shape in policy.policy.shapes.items() if len(shape) == 1}, 0, 0
    lines = [f"    float joined[{sum(counts.values()) + sum(widths.values())}];"]
    for key in policy.policy.shapes:
        wide, source = (counts[key], f"seen[{first} + i]") if key in counts else (widths[key], f"{key}_features[i]")
        first += counts.get(key, 0)
        lines.append(f"    for (int i = 0; i < {wide}; ++i) joined[{place} + i] = {source};")
        place += wide
    return "\n".join(lines)
