"""A policy as C99: one header and one source, weights inside, no library but math.h and stdint.h, no allocation.

Letters: O entries of an observation, U of a command, V of an action, M numbers of memory.
"""

from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from math import prod
from typing import Any

import torch
from torch import Tensor, nn

from aerial_gym.errors import ConfigError
from aerial_gym.export import c99_images
from aerial_gym.export.layout import Layout, ObservationTerm
from aerial_gym.export.module import C_FINITE, DeployablePolicy, action_transform
from aerial_gym.sensors.encoder.file import Encoder
from aerial_gym.task.terms import actions

LINE = 110  # Columns of a line of weights


def policy_header(layout: Layout, *, work: int = 0) -> str:
    """Return the header: sizes, state, two functions, and the meaning of every entry; ``work`` sizes the image layers."""
    n, upper = layout.name, layout.name.upper()
    memory = f"\n    float memory[{layout.memory}];" if layout.memory else ""
    memory += f"\n    float work[2][{work}];" if layout.images else ""
    looks = " * images\n" + "".join(c99_images.image_comment(image) for image in layout.images) if layout.images else ""
    seen = "\n".join(map(_observation_comment, layout.observation))
    given = "\n".join(f" *   {i:>9}  {name}" for i, name in enumerate(layout.command))
    return f"""/* A policy of {layout.task} for {layout.robot} with {layout.controller}; aerial_gym {layout.version}.
 * Ask it every {1e3 / layout.rate_hz:.4g} ms ({layout.rate_hz:.4g} Hz), as in training.
 *
 * observation
{seen}
{looks} * command
{given}
 */
#ifndef {upper}_H
#define {upper}_H

#define {upper}_NUM_OBSERVATIONS {layout.num_observations}
#define {upper}_NUM_COMMANDS {len(layout.command)}
#define {upper}_NUM_ACTIONS {layout.num_actions}

/* What stays from step to step: the last action, -1 to 1{", and the memory" if layout.memory else ""}{
        "; and work space" if layout.images else ""
    }. */
typedef struct {{
    float action[{layout.num_actions}];{memory}
}} {n}_state;

/* Before the first step, and where a new flight begins. */
void {n}_reset({n}_state *state);

/* Returns 0. Returns 1, with NaN in command and {
        "state" if layout.memory else "action"
    }, if a number that goes in, or the
 * action before its limits, is NaN or infinite. {
        _AFTER_ERROR if layout.memory else "The next step is not affected."
    } */
{step_declaration(layout)};

#endif
"""


def step_declaration(layout: Layout) -> str:
    """Return the head of the function that flies."""
    seen, given = layout.num_observations, len(layout.command)
    head = f"int {layout.name}_step({layout.name}_state *state, const float observation[{seen}], "
    return f"{head}{c99_images.image_parameters(layout)}float command[{given}])"


def policy_source(policy: DeployablePolicy, layout: Layout, *, storage: str = "") -> str:
    """Return the source; ``storage`` (``"static "``) takes the layers off the stack, for one caller at a time."""
    n, body = layout.name, policy.policy.body
    transform, params = action_transform(layout)
    if transform not in _TRANSFORMS:
        raise ConfigError(f"action {layout.transform}: has no form in C. Export onnx or torchscript")
    write = _TRANSFORMS[transform]
    command = f"    for (int i = 0; i < {len(layout.command)}; ++i) command[i] = action[i];"
    parts: list[str] = []
    mean, std, limit = policy.normalization()
    scale = policy.scale.double()
    parts += [_c_array("shift", mean.double() / scale), _c_array("factor", scale / std.double())]
    looks = c99_images.image_code(policy, layout, _c_array)
    parts += looks.arrays
    linears = [layer for layer in body.layers if isinstance(layer, nn.Linear)]
    for i, layer in enumerate(linears):
        parts += [_c_array(f"weight_{i}", layer.weight), _c_array(f"bias_{i}", layer.bias)]
    widths = [layout.num_observations + sum(looks.widths.values()), *(layer.out_features for layer in linears)]
    cell = body.cell
    if cell is not None:
        parts += [_c_array("entering", cell.weight_ih), _c_array("entering_bias", cell.bias_ih)]
        parts += [_c_array("held", cell.weight_hh), _c_array("held_bias", cell.bias_hh)]
    parts += [_c_array("head", policy.policy.head.weight), _c_array("head_bias", policy.policy.head.bias)]
    clamped = "" if limit is None else f"\n        seen[i] = clamped(seen[i], {_c_number(limit)});"
    layers, before = [], "seen"
    if layout.images:
        layers, before = [looks.code, c99_images.join_code(policy, looks.widths)], "joined"
    for i, (wide_in, wide_out) in enumerate(pairwise(widths)):
        layers += [
            f"    {storage}float layer_{i}[{wide_out}];",
            f"    dense(weight_{i}, bias_{i}, {wide_in}, {wide_out}, {before}, layer_{i});",
            f"    for (int i = 0; i < {wide_out}; ++i) layer_{i}[i] = activated(layer_{i}[i]);",
        ]
        before = f"layer_{i}"
    if cell is not None:
        layers.append(_MEMORY.format(storage=storage, features=before, wide=widths[-1], m=layout.memory))
        before = "state->memory"
    lines = "\n".join(layers)
    checked = {"observation": layout.num_observations, **({"state->memory": layout.memory} if layout.memory else {})}
    checked |= {image.key: prod(image.shape) for image in layout.images if image.dtype == "float32"}
    outputs = {"command": len(layout.command), "state->action": layout.num_actions}
    outputs |= {"state->memory": layout.memory} if layout.memory else {}
    forget = f"\n    for (int i = 0; i < {layout.memory}; ++i) state->memory[i] = 0.0f;" if layout.memory else ""
    activation = _ACTIVATIONS[body.cfg.activation] if linears or layout.images else ""
    activation += c99_images.CONVOLVE if layout.images else ""
    logistic = "static float logistic(float x) { return 1.0f / (1.0f + expf(-x)); }\n" if cell is not None else ""
    return f"""#include "{n}.h"

#include <math.h>
#include <stdint.h>

{chr(10).join(parts)}
{C_FINITE}static float clamped(float x, float limit) {{ return x < -limit ? -limit : (x > limit ? limit : x); }}
{activation}{logistic}
{_DENSE}
void {n}_reset({n}_state *state) {{
    for (int i = 0; i < {layout.num_actions}; ++i) state->action[i] = 0.0f;{forget}
}}

{step_declaration(layout)} {{
    int finite = {_finite_condition(checked)};
    {storage}float seen[{layout.num_observations}];
    for (int i = 0; i < {layout.num_observations}; ++i) {{
        seen[i] = (observation[i] - shift[i]) * factor[i];{clamped}
    }}
{lines}
    dense(head, head_bias, {policy.policy.head.in_features}, {layout.num_actions}, {before}, state->action);
    finite = finite && is_finite(state->action, {layout.num_actions});
    for (int i = 0; i < {layout.num_actions}; ++i) state->action[i] = clamped(state->action[i], 1.0f);
    const float *action = state->action;
{write(params) if write else command}
{_return_statements(outputs)}
}}
"""


def encoder_header(encoder: Encoder, name: str) -> str:
    """Return the header of an encoder: sizes, work space, and the function from an image to latents."""
    upper, seen = name.upper(), encoder.seen
    return f"""/* An encoder of {seen}.
 *
 * image: {seen.rows} x {seen.columns} pixels, row by row from the top, each as a share of the largest distance, 0 to 1;
 * latents: what goes into image_latents of the policy.
 */
#ifndef {upper}_H
#define {upper}_H

#define {upper}_ROWS {seen.rows}
#define {upper}_COLUMNS {seen.columns}
#define {upper}_LATENTS {encoder.num_latents}

/* Work space of one call: nothing stays. */
typedef struct {{
    float work[2][{_encoder_code(encoder, lambda _, __: "").work}];
}} {name}_space;

/* Returns 0. Returns 1, with NaN in all latents, if a pixel or a latent is NaN or infinite. */
{_encoder_declaration(encoder, name)};

#endif
"""


def encoder_source(encoder: Encoder, name: str) -> str:
    """Return the source of an encoder."""
    passed, pixels = _encoder_code(encoder, _c_array), encoder.seen.rows * encoder.seen.columns
    return f"""#include "{name}.h"

#include <math.h>
#include <stdint.h>

{chr(10).join(passed.arrays)}
{C_FINITE}{_ACTIVATIONS[encoder.cfg.activation]}{c99_images.CONVOLVE}
{_DENSE}
{_encoder_declaration(encoder, name)} {{
    int finite = {_finite_condition({"image": pixels})};
    for (int i = 0; i < {pixels}; ++i) state->work[0][i] = image[i];
{passed.code}
    finite = finite && is_finite(latents, {encoder.num_latents});
{_return_statements({"latents": encoder.num_latents})}
}}
"""


def _encoder_declaration(encoder: Encoder, name: str) -> str:
    pixels = encoder.seen.rows * encoder.seen.columns
    return f"int {name}_encode({name}_space *state, const float image[{pixels}], float latents[{encoder.num_latents}])"


def _finite_condition(arrays: Mapping[str, int]) -> str:
    """Return a C expression: whether all entries of some arrays are finite."""
    return " && ".join(f"is_finite({name}, {count})" for name, count in arrays.items())


def _return_statements(outputs: Mapping[str, int]) -> str:
    """Return the last C statements of a function: NaN in all outputs and 1, unless ``finite``."""
    bad = " ".join(f"set_nan({name}, {count});" for name, count in outputs.items())
    return f"    if (!finite) {{ {bad} }}\n    return !finite;"


def _encoder_code(encoder: Encoder, array: Callable[[str, Tensor], str]) -> c99_images.ImageCode:
    return c99_images.layer_code(
        encoder.layers, (1, encoder.seen.rows, encoder.seen.columns), array, name="layer", out="latents"
    )


_AFTER_ERROR = "Then reset the state, or restore a copy of it from before the step."
"""Remedy after an error for the caller of a policy with a memory."""

_DENSE = """/* Sums of 32 products each: rounding grows with the root of their number, not of num_in. */
static void dense(const float *weight, const float *bias, int num_in, int num_out, const float *in, float *out) {
    for (int o = 0; o < num_out; ++o) {
        float sum = bias[o];
        for (int first = 0; first < num_in; first += 32) {
            const int end = first + 32 < num_in ? first + 32 : num_in;
            float part = 0.0f;
            for (int i = first; i < end; ++i) part += weight[o * num_in + i] * in[i];
            sum += part;
        }
        out[o] = sum;
    }
}
"""

_ACTIVATIONS = {
    "elu": "static float activated(float x) { return x > 0.0f ? x : expm1f(x); }\n",
    "relu": "static float activated(float x) { return x < 0.0f ? 0.0f : x; } /* NaN stays NaN */\n",
    "tanh": "static float activated(float x) { return tanhf(x); }\n",
}

_MEMORY = """    {storage}float from_seen[3 * {m}], from_memory[3 * {m}]; /* reset, update, new */
    dense(entering, entering_bias, {wide}, 3 * {m}, {features}, from_seen);
    dense(held, held_bias, {m}, 3 * {m}, state->memory, from_memory);
    for (int i = 0; i < {m}; ++i) {{
        const float reset = logistic(from_seen[i] + from_memory[i]);
        const float update = logistic(from_seen[{m} + i] + from_memory[{m} + i]);
        const float fresh = tanhf(from_seen[2 * {m} + i] + reset * from_memory[2 * {m} + i]);
        state->memory[i] = fresh + update * (state->memory[i] - fresh);
    }}"""


def _forward_flight_code(params: Mapping[str, Any]) -> str:
    return f"""    const float speed = {_c_number(0.5 * params["max_speed"])} * (action[0] + 1.0f);
    const float inclination = {_c_number(params["max_inclination"])} * action[1];
    command[0] = speed * cosf(inclination);
    command[1] = 0.0f;
    command[2] = speed * sinf(inclination);
    command[3] = {_c_number(params["max_yaw_rate"])} * action[2];"""


def _affine_code(params: Mapping[str, Any]) -> str:
    places = params.get("order") or range(len(params["low"]))
    lines = [
        f"    command[{i}] = {_c_number(0.5 * (b - a))} * (action[{place}] + 1.0f) + {_c_number(a)};"
        for i, (place, a, b) in enumerate(zip(places, params["low"], params["high"], strict=True))
    ]
    return "\n".join(lines)


def _four_places_code(params: Mapping[str, Any]) -> str:
    lines = ["    float lift[4];"]
    lines += [f"    lift[{i}] = 0.25f * (action[{i}] + 1.0f) * (action[{i}] + 1.0f);" for i in range(4)]
    rotors = zip(params["mix"], params["low"], params["high"], params["speeds"], strict=True)
    for i, (row, low, high, speed) in enumerate(rotors):
        share = " + ".join(f"{_c_number(weight)} * lift[{k}]" for k, weight in enumerate(row))
        size = f"fminf(fmaxf(fabsf(share), {_c_number(actions.NEGLIGIBLE)}), 1.0f)"
        size = f"sqrtf({size})" if speed else size
        if low < 0.0:
            signed = f"{_c_number(high)} * (share > 0.0f ? size : share < 0.0f ? -size : 0.0f)"
            expression = f"fminf(fmaxf({signed}, {_c_number(low)}), {_c_number(high)})"
        else:
            expression = f"share > 0.0f ? {_c_number(low)} + {_c_number(high - low)} * size : {_c_number(low)}"
        lines.append(f"    {{ const float share = {share}, size = {size};")
        lines.append(f"      command[{i}] = {expression}; }}")
    return "\n".join(lines)


_TRANSFORMS: dict[Callable[..., Tensor], Callable[[Mapping[str, Any]], str] | None] = {
    actions.direct: None, actions.forward_flight: _forward_flight_code, actions.affine: _affine_code,
    actions.four_places: _four_places_code,
}  # fmt: skip
"""The transforms of actions, in C; None: the command is the action."""


def _observation_comment(term: ObservationTerm) -> str:
    """Return the line of the header on a term: its entries, its name and its meaning."""
    entries = str(term.first) if term.count == 1 else f"{term.first} to {term.first + term.count - 1}"
    history = "" if term.history == 1 else f"; of the last {term.history} steps, oldest first"
    return f" *   {entries:>9}  {term.term}: {term.meaning}{history}"


def _c_number(value: float) -> str:
    """Return a number of float32 in C."""
    (text,) = _c_numbers(torch.tensor([value], dtype=torch.float64))
    return text


def _c_array(name: str, values: Tensor) -> str:
    """Return the definition of a constant array."""
    lines, line = [], "   "
    for text in _c_numbers(values.detach().flatten()):
        if len(line) + len(text) + 2 > LINE:
            lines.append(line)
            line = "   "
        line += f" {text},"
    return f"static const float {name}[{values.numel()}] = {{\n" + "\n".join([*lines, line]) + "\n};"


def _c_numbers(values: Tensor) -> Iterable[str]:
    """Return the numbers (N,) of float32 in C, each to its last digit."""
    texts = (f"{value:.9g}" for value in values.float().tolist())
    return (f"{text if '.' in text or 'e' in text else text + '.0'}f" for text in texts)
