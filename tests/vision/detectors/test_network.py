"""Networks in ONNX files: small graphs whose answers are known are made by onnx's own library."""

import json
import pickle

import numpy as np
import pytest

from toile.errors import UserError
from toile.vision.detectors.network import Network, cropped

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
H, W = 64, 48
THREE = ["face.nose_tip", "body.wrist.L", "body.wrist.R"]
PLAIN = {"mean": [0, 0, 0], "std": [255, 255, 255], "padding": 1.0}


def graph(path, nodes, outputs, size=(H, W), channels=3):
    from onnx import TensorProto, checker, helper

    value = lambda name, shape: helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
    made = helper.make_graph(
        nodes, "g", [value("input", ["n", channels, *size])], [value(n, s) for n, s in outputs.items()]
    )
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 11)], ir_version=7)
    checker.check_model(model)
    onnx.save(model, path)
    return path


def simcc(path):
    """Point k is where channel k is brightest, in bins of half a pixel."""
    from onnx import helper

    scales = helper.make_node(
        "Constant", [], ["s"], value=helper.make_tensor("s", onnx.TensorProto.FLOAT, [3], [1.0, 1.0, 2.0])
    )
    nodes, outputs = [scales], {}
    for axis, (name, count) in enumerate({"simcc_x": W, "simcc_y": H}.items()):
        nodes.append(helper.make_node("ReduceMax", ["input"], [f"m{axis}"], axes=[2 + axis], keepdims=0))
        nodes.append(helper.make_node("Resize", [f"m{axis}", "roi", "s"], [name], mode="nearest",
                                      coordinate_transformation_mode="asymmetric", nearest_mode="floor"))  # fmt: skip
        outputs[name] = ["n", 3, 2 * count]
    roi = helper.make_node(
        "Constant", [], ["roi"], value=helper.make_tensor("roi", onnx.TensorProto.FLOAT, [6], [0, 0, 0, 1, 1, 1])
    )
    return graph(path, [roi, *nodes], outputs)


def heatmaps(path):
    from onnx import helper

    pool = helper.make_node("AveragePool", ["input"], ["heatmaps"], kernel_shape=[4, 4], strides=[4, 4])
    return graph(path, [pool], {"heatmaps": ["n", 3, H // 4, W // 4]})


def described(path, **more):
    lines = [f"{name} = {json.dumps(value)}" for name, value in (PLAIN | {"names": THREE} | more).items()]
    path.with_suffix(".toml").write_text("\n".join(lines))
    return path


def blobs(at, size=(200, 150), sigma=6.0):
    """A picture with one Gaussian blob a channel, at (3,2) [px]."""
    v, u = np.mgrid[: size[0], : size[1]] + 0.5
    far = (u - at[:, 0, None, None]) ** 2 + (v - at[:, 1, None, None]) ** 2
    return np.rint(255 * np.exp(-far / (2 * sigma**2))).astype(np.uint8).transpose(1, 2, 0)


AT = np.array([[40.2, 30.7], [75.0, 120.4], [110.9, 81.3]])
BOX = np.array([0.0, 0, 150, 200])


def test_simcc_points_lie_where_the_blobs_are(tmp_path):
    network = Network(described(simcc(tmp_path / "a.onnx")))
    rows = network.keypoints(blobs(AT), BOX)
    assert network.about.kind == "simcc" and np.abs(rows[:, :2] - AT).max() < 200 / H
    assert (rows[:, 2] > 0.9).all()


def test_heatmap_points_are_found_between_the_cells(tmp_path):
    """A cell is 12.5 px of the picture here; the point lies in the middle of its four pixels, which is 1.5 px of the crop."""
    network = Network(described(heatmaps(tmp_path / "a.onnx")))
    at = 0.3 * AT + [52, 70]  # away from the edges
    rows = network.keypoints(blobs(at, sigma=15.0), BOX)
    assert network.about.kind == "heatmap" and np.abs(rows[:, :2] + 1.5 * 200 / H - at).max() < 0.5


def test_a_point_of_the_crop_goes_back_to_its_place_in_the_picture(tmp_path):
    about = Network(described(simcc(tmp_path / "a.onnx"))).about
    picture = blobs(AT, sigma=8.0)
    crop, scale, corner = cropped(picture, [20.0, 10, 140, 150], about)
    for channel in range(3):
        weight = np.maximum(crop[channel], 0)
        v, u = np.mgrid[:H, :W]
        middle = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
        assert np.abs(scale * middle + corner - AT[channel]).max() < 0.3


def test_channels_of_the_other_order_exchange_red_and_blue(tmp_path):
    rgb = Network(described(simcc(tmp_path / "a.onnx"))).keypoints(blobs(AT), BOX)
    bgr = Network(described(simcc(tmp_path / "b.onnx"), channels="bgr")).keypoints(blobs(AT), BOX)
    assert np.array_equal(rgb, bgr[::-1])


def test_without_a_box_the_second_crop_is_drawn_by_the_first(tmp_path):
    """The person is small in the picture: the second look is nearer."""
    at = 300 + 0.3 * AT
    picture = blobs(at, (800, 600), sigma=6.0)
    names = ["face.nose_tip", "body.wrist.L", "body.wrist.R"]
    found = Network(described(simcc(tmp_path / "a.onnx"), names=names)).keypoints(picture)
    assert np.abs(found[:, :2] - at).max() < 800 / H


def test_what_an_exporter_left_beside_the_file_is_read(tmp_path):
    path = simcc(tmp_path / "end2end.onnx")
    normal = {"type": "Normalize", "mean": [1.0, 2, 3], "std": [4.0, 5, 6], "to_rgb": False}
    box = {"type": "TopDownGetBboxCenterScale", "padding": 1.5}
    task = {"transforms": [normal, box], "params": {"type": "SimCCLabelDecode"}}
    (tmp_path / "pipeline.json").write_text(json.dumps({"pipeline": {"tasks": [task]}}))
    path.with_suffix(".toml").write_text(f"names = {json.dumps(THREE)}\nstd = [7, 8, 9]")
    about = Network(path).about
    assert (about.mean, about.std, about.channels, about.padding) == ((1, 2, 3), (7, 8, 9), "bgr", 1.5)
    (tmp_path / "pipeline.json").unlink()
    config = {"image_mean": [0.5, 0.5, 0.5], "image_std": [0.25, 0.25, 0.25], "rescale_factor": 1 / 255}
    (tmp_path / "preprocessor_config.json").write_text(json.dumps(config))
    path.with_suffix(".toml").write_text(f"names = {json.dumps(THREE)}")
    assert np.allclose(Network(path).about.mean, 127.5) and np.allclose(Network(path).about.std, 63.75)


@pytest.mark.parametrize(
    "change, said",
    [
        ({"names": None}, "which 3 points it gives is not said"),
        ({"names": ["a"]}, "names: 1 of them, the network gives 3"),
        ({"names": "halpe27"}, "expected one of coco17"),
        ({"names": "halpe26"}, "gives 3 points, 'halpe26' has 26"),
        ({"padding": 0.5}, "padding"),
        ({"colour": "rgb"}, "colour"),
    ],
)
def test_a_description_that_does_not_fit_is_refused_by_its_field(tmp_path, change, said):
    path = described(simcc(tmp_path / "a.onnx"), **change)
    if change.get("names", 0) is None:
        path.with_suffix(".toml").unlink()
    with pytest.raises(UserError, match=said):
        Network(path)


def test_files_that_are_no_network_of_keypoints_are_refused(tmp_path):
    from onnx import helper

    (tmp_path / "text.onnx").write_text("nothing")
    with pytest.raises(UserError, match="cannot be read as an ONNX network"):
        Network(tmp_path / "text.onnx")
    with pytest.raises(UserError, match="the file is missing"):
        Network(tmp_path / "none.onnx")
    flat = helper.make_node("GlobalAveragePool", ["input"], ["out"])
    grey = graph(tmp_path / "grey.onnx", [flat], {"out": ["n", 1, 1, 1]}, channels=1)
    with pytest.raises(UserError, match="not one batch of pictures"):
        Network(grey)
    loose = graph(tmp_path / "loose.onnx", [flat], {"out": ["n", 3, 1, 1]}, size=("h", "w"))
    with pytest.raises(UserError, match="size of its input is not fixed"):
        Network(loose)


def test_a_network_finds_the_same_in_another_process(tmp_path):
    network = Network(described(simcc(tmp_path / "a.onnx")))
    picture = blobs(AT)
    assert np.array_equal(pickle.loads(pickle.dumps(network)).keypoints(picture), network.keypoints(picture))
