"""Dense layers as a ``.tflite`` file: the part of the TensorFlow Lite schema, version 3, that they need.

A table is written as (slot, value) pairs, without a generated schema. Slots and numbers are those of the public schema,
github.com/tensorflow/tensorflow, ``tensorflow/compiler/mlir/lite/schema/schema.fbs``.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from torch import Tensor

from aerial_gym.extras import optional_import

if TYPE_CHECKING:
    import flatbuffers

VERSION, IDENTIFIER = 3, b"TFL3"
FULLY_CONNECTED = 9  # BuiltinOperator
FULLY_CONNECTED_OPTIONS = 8  # BuiltinOptions
RELU = 1  # ActivationFunctionType
FLOAT32 = 0  # TensorType
ALIGNMENT = 16  # Of buffers [B]
INT, OFFSET = "Int32", "UOffsetTRelative"  # Kinds of vectors


class Dense(NamedTuple):
    """``x W' + b``, and ``relu`` of it on request."""

    weight: Tensor  # (outputs, inputs)
    bias: Tensor  # (outputs,)
    relu: bool


def dense_model(layers: Sequence[Dense], description: str) -> bytes:
    """Return a model of dense layers: one float32 input (1, I) and one output."""
    with optional_import("export to TensorFlow Lite"):
        import flatbuffers
    builder = flatbuffers.Builder(1024)
    buffers = [_table(builder, ())]  # buffer 0 is empty: that of tensors without constant values
    tensors, operators = [_tensor(builder, "observation", (1, layers[0].weight.shape[1]), 0)], []
    for number, layer in enumerate(layers):
        source = len(tensors) - 1
        for name, values in (("weight", layer.weight), ("bias", layer.bias)):
            data = _bytes(builder, values.detach().float().numpy().tobytes())
            buffers.append(_table(builder, ((0, data),)))
            tensors.append(_tensor(builder, f"{name}_{number}", tuple(values.shape), len(buffers) - 1))
        tensors.append(_tensor(builder, f"layer_{number}", (1, len(layer.bias)), 0))
        options = _table(builder, (), ((0, "Int8", RELU if layer.relu else 0),))
        inputs = _vector(builder, (source, source + 1, source + 2), INT)
        outputs = _vector(builder, (source + 3,), INT)
        kind = ((0, "Uint32", 0), (3, "Uint8", FULLY_CONNECTED_OPTIONS))
        operators.append(_table(builder, ((1, inputs), (2, outputs), (4, options)), kind))
    ends = (_vector(builder, (0,), INT), _vector(builder, (len(tensors) - 1,), INT))
    parts = (_vector(builder, tensors, OFFSET), *ends, _vector(builder, operators, OFFSET))
    graph = _table(builder, tuple(enumerate(parts)))
    code = _table(builder, (), ((0, "Int8", FULLY_CONNECTED), (2, "Int32", 1), (3, "Int32", FULLY_CONNECTED)))
    fields = (
        (1, _vector(builder, [code], OFFSET)), (2, _vector(builder, [graph], OFFSET)), (3, builder.CreateString(description)),
        (4, _vector(builder, buffers, OFFSET)),
    )  # fmt: skip
    builder.Finish(_table(builder, fields, ((0, "Uint32", VERSION),)), file_identifier=IDENTIFIER)
    return bytes(builder.Output())


def _table(
    builder: "flatbuffers.Builder", offsets: Sequence[tuple[int, int]], scalars: Sequence[tuple[int, str, int]] = ()
) -> int:
    """Return the place of a table with (slot, place) and (slot, type, number) fields."""
    builder.StartObject(8)
    for slot, offset in offsets:
        builder.PrependUOffsetTRelativeSlot(slot, offset, 0)
    for slot, kind, number in scalars:
        getattr(builder, f"Prepend{kind}Slot")(slot, number, 0)
    return builder.EndObject()


def _tensor(builder: "flatbuffers.Builder", name: str, shape: Sequence[int], buffer: int) -> int:
    offsets = ((0, _vector(builder, shape, INT)), (3, builder.CreateString(name)))
    return _table(builder, offsets, ((1, "Int8", FLOAT32), (2, "Uint32", buffer)))


def _vector(builder: "flatbuffers.Builder", values: Sequence[int], kind: str) -> int:
    builder.StartVector(4, len(values), 4)
    for value in reversed(values):
        getattr(builder, f"Prepend{kind}")(value)
    return builder.EndVector()


def _bytes(builder: "flatbuffers.Builder", data: bytes) -> int:
    """Return the place of constant values, aligned as the schema asks."""
    builder.StartVector(1, len(data), ALIGNMENT)
    builder.head = builder.Head() - len(data)
    builder.Bytes[builder.Head() : builder.Head() + len(data)] = data
    return builder.EndVector()
