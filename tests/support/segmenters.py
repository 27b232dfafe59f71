"""Networks of labels whose answers are known, made by onnx's own library."""

import json

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
CLASSES = ["background", "top", "legs", "skin"]
MAP = {"top": "tshirt", "legs": "trousers"}  # background and skin need no line
PLAIN = {"mean": [0, 0, 0], "std": [255, 255, 255]}
SIZE = (48, 32)


def graph(path, nodes, outputs, size=SIZE, kind=onnx.TensorProto.FLOAT):
    from onnx import TensorProto, checker, helper

    value = lambda name, shape, kind: helper.make_tensor_value_info(name, kind, shape)
    made = helper.make_graph(
        nodes,
        "g",
        [value("image", ["n", 3, *size], TensorProto.FLOAT)],
        [value(n, s, kind) for n, s in outputs.items()],
    )
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    checker.check_model(model)
    onnx.save(model, path)
    return path


def constant(name, values, kind=onnx.TensorProto.FLOAT):
    from onnx import helper

    values = np.asarray(values)
    tensor = helper.make_tensor(name, kind, values.shape, values.ravel())
    return helper.make_node("Constant", [], [name], value=tensor)


def by_colour(path, size=SIZE, sharp=40.0, stride=1):
    """Logits: red is the top, green the legs, blue the skin, black the background."""
    from onnx import helper

    weights = sharp * np.concatenate([np.zeros((1, 3)), np.eye(3)])[..., None, None].astype(np.float32)
    nodes = [constant("w", weights), constant("b", sharp * np.array([0.5, 0, 0, 0], np.float32))]
    nodes.append(helper.make_node("Conv", ["image", "w", "b"], ["logits"], strides=[stride, stride]))
    return graph(path, nodes, {"logits": ["n", 4, "h", "w"]}, size)


def described(path, **more):
    given = PLAIN | {"classes": CLASSES} | more
    labels = given.pop("labels", MAP)
    lines = [f"{name} = {json.dumps(value)}" for name, value in given.items() if value is not None]
    lines += ["[labels]", *(f"{json.dumps(name)} = {json.dumps(value)}" for name, value in labels.items())]
    path.with_suffix(".toml").write_text("\n".join(lines))
    return path
