"""The trained network as an ONNX file, its weights stored in half precision, and its weights back from there."""

from __future__ import annotations

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper

from ...errors import UserError
from .network import Clothes

HALVED = "_half"  # end of the names of stored weights
COUNTED = "num_batches_tracked"  # what torch counts and nobody needs


def export(network, path, size=256):
    """Writes a Clothes: `image` (N,3,size,size) normalised, `logits` (N,C,size,size)."""
    network = network.eval().to(memory_format=torch.contiguous_format)
    torch.onnx.export(
        network,
        torch.zeros(1, 3, size, size),
        path,
        input_names=["image"],
        output_names=["logits"],
        dynamic_axes={"image": {0: "n"}, "logits": {0: "n"}},
        dynamo=False,
        opset_version=17,
        training=torch.onnx.TrainingMode.PRESERVE,  # normalisations stay, and with them the names of the weights
        do_constant_folding=False,
    )
    graph = onnx.load(path)
    halve(graph.graph)
    onnx.checker.check_model(graph, full_check=True)
    onnx.save(graph, path)


def halve(graph):
    """Stores the kernels of convolutions as float16, made float32 when the file is opened."""
    for i, weight in enumerate(graph.initializer):
        name, values = weight.name, numpy_helper.to_array(weight)
        if values.ndim == 4:
            graph.initializer[i].CopyFrom(numpy_helper.from_array(values.astype(np.float16), name + HALVED))
            graph.node.insert(0, helper.make_node("Cast", [name + HALVED], [name], to=onnx.TensorProto.FLOAT))


def read_network(path):
    """The Clothes that `export` wrote. UserError: the file holds another network."""
    stored = {w.name.removesuffix(HALVED): numpy_helper.to_array(w) for w in onnx.load(path).graph.initializer}
    network = Clothes()
    wanted = {name for name, _ in network.named_parameters()} | {
        n for n, _ in network.named_buffers() if COUNTED not in n
    }
    if not wanted <= stored.keys() or any(stored[n].shape != network.state_dict()[n].shape for n in wanted):
        raise UserError(f"{path}: not the weights of this network")
    weights = {name: torch.from_numpy(stored[name].astype(np.float32)) for name in wanted}
    network.load_state_dict(weights, strict=False)
    return network.eval()
