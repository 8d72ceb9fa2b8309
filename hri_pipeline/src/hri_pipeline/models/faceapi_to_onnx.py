"""The three face-api networks (expression, age and gender, identity) as ONNX graphs.

The package carries weights only; the architectures are written here: "tiny Xception" (Chollet 2017) for age
and gender, a small densely connected network for expression, and dlib's ResNet (King 2017) for identity.
Input `image`: N x S x S x 3, RGB, 0..255.
"""

from __future__ import annotations

import json
from typing import Any, Callable, Dict, Mapping, Sequence

import numpy as np

from hri_pipeline.models.catalogue import ConversionError
from hri_pipeline.models.onnx_graph import GraphBuilder
from hri_pipeline.models.tfjs_to_onnx import read_weights

MEAN_RGB = (122.782, 117.001, 104.298)  # mean colour of the training pictures, 0..255
SIZES = {"age_gender": 112, "face_expression": 112, "face_recognition": 150}


class FaceApiNetwork:
    """Building blocks over a set of named weights."""

    def __init__(self, weights: Mapping[str, np.ndarray], model_name: str, size: int) -> None:
        self.weights = weights
        self.model_name = model_name
        self.build = GraphBuilder(model_name)
        self.image = self._normalised(self.build.input("image", ["N", size, size, 3]))

    def weight(self, name: str) -> np.ndarray:
        """A weight by name.  ConversionError when the package does not hold it."""
        if name not in self.weights:
            raise ConversionError("model %s: weight %s is missing in the package" % (self.model_name, name))
        return self.weights[name]

    def convolution(
        self, value: str, filters: np.ndarray, bias: np.ndarray, stride: int = 1, padding: str = "SAME_UPPER"
    ) -> str:
        """Convolution; `filters` is H x W x in x out."""
        filters = filters.transpose(3, 2, 0, 1)
        inputs = [value, self.build.floats(filters), self.build.floats(bias)]
        return self.build.node(
            "Conv", inputs, strides=[stride, stride], auto_pad=padding, kernel_shape=list(filters.shape[2:])
        )

    def named_convolution(self, value: str, prefix: str, stride: int = 1) -> str:
        """Convolution with the weights prefix/filters and prefix/bias."""
        return self.convolution(
            value, self.weight(prefix + "/filters"), self.weight(prefix + "/bias"), stride
        )

    def separable(self, value: str, prefix: str, stride: int = 1) -> str:
        """Depthwise convolution, then 1 x 1 convolution with bias."""
        filters = self.weight(prefix + "/depthwise_filter").transpose(2, 3, 0, 1)
        value = self.build.node(
            "Conv",
            [value, self.build.floats(filters)],
            strides=[stride, stride],
            auto_pad="SAME_UPPER",
            group=filters.shape[0],
            kernel_shape=list(filters.shape[2:]),
        )
        return self.convolution(
            value, self.weight(prefix + "/pointwise_filter"), self.weight(prefix + "/bias")
        )

    def relu(self, value: str) -> str:
        """Rectifier."""
        return self.build.node("Relu", [value])

    def add(self, first: str, second: str) -> str:
        """Sum."""
        return self.build.node("Add", [first, second])

    def dense(self, value: str, prefix: str) -> str:
        """Fully connected layer with the weights prefix/weights and prefix/bias."""
        return self.build.node(
            "Gemm",
            [
                value,
                self.build.floats(self.weight(prefix + "/weights")),
                self.build.floats(self.weight(prefix + "/bias")),
            ],
        )

    def pooled_features(self, value: str) -> str:
        """Mean over the 7 x 7 map, one row per image."""
        value = self.build.node("AveragePool", [value], kernel_shape=[7, 7], strides=[2, 2])
        return self.build.node("Flatten", [value])

    def _normalised(self, value: str) -> str:
        mean = self.build.floats(np.reshape(MEAN_RGB, (1, 3, 1, 1)))
        centred = self.build.node("Sub", [self.build.to_channels_first(value), mean])
        return self.build.node("Mul", [centred, self.build.floats(1 / 255.0)])


def convert_faceapi(manifest: bytes, read_shard: Callable[[str], bytes], network: str) -> Any:
    """Convert one network, "age_gender", "face_expression" or "face_recognition", to an ONNX model.

    `manifest` is the weights manifest (JSON), `read_shard` gives a weight file by its name.
    ConversionError when weights are missing or the network is not known.
    """
    if network not in _NETWORKS:
        raise ConversionError(
            "model %s: face-api has no network of this name (known: %s)" % (network, ", ".join(_NETWORKS))
        )
    weights = read_weights(json.loads(manifest.decode("utf-8")), read_shard, network)
    layers = FaceApiNetwork(weights, network, SIZES[network])
    _NETWORKS[network](layers)
    return layers.build.build()


def _age_gender(net: FaceApiNetwork) -> None:
    value = net.relu(net.named_convolution(net.image, "entry_flow/conv_in", 2))
    value = _reduction(net, value, "entry_flow/reduction_block_0", activate=False)
    value = _reduction(net, value, "entry_flow/reduction_block_1")
    for block in range(2):
        inner = value
        for layer in range(3):
            inner = net.separable(
                net.relu(inner), "middle_flow/main_block_%d/separable_conv%d" % (block, layer)
            )
        value = net.add(inner, value)
    value = _reduction(net, value, "exit_flow/reduction_block")
    value = net.pooled_features(net.relu(net.separable(value, "exit_flow/separable_conv")))
    gender = net.build.node("Softmax", [net.dense(value, "fc/gender")], axis=1)
    net.build.output("age", net.dense(value, "fc/age"), ["N", 1])  # years
    net.build.output("gender", gender, ["N", 2])  # (male, female)


def _reduction(net: FaceApiNetwork, value: str, prefix: str, activate: bool = True) -> str:
    inner = net.separable(net.relu(value) if activate else value, prefix + "/separable_conv0")
    inner = net.separable(net.relu(inner), prefix + "/separable_conv1")
    inner = net.build.node("MaxPool", [inner], kernel_shape=[3, 3], strides=[2, 2], auto_pad="SAME_UPPER")
    return net.add(inner, net.named_convolution(value, prefix + "/expansion_conv", 2))


def _expression(net: FaceApiNetwork) -> None:
    value = net.image
    for block in range(4):
        prefix = "dense%d/conv" % block
        if block == 0:
            first = net.relu(net.named_convolution(value, prefix + "0", 2))
        else:
            first = net.relu(net.separable(value, prefix + "0", 2))
        total = first
        for layer in (1, 2, 3):
            source = first if layer == 1 else net.relu(total)
            total = net.add(total, net.separable(source, prefix + str(layer)))
        value = net.relu(total)
    scores = net.build.node("Softmax", [net.dense(net.pooled_features(value), "fc")], axis=1)
    # neutral, happy, sad, angry, fearful, disgusted, surprised
    net.build.output("expression", scores, ["N", 7])


def _scaled_convolution(
    net: FaceApiNetwork, value: str, prefix: str, stride: int = 1, padding: str = "SAME_UPPER"
) -> str:
    """Convolution with dlib's per-channel scale folded into its weights."""
    scale, shift = net.weight(prefix + "/scale/weights"), net.weight(prefix + "/scale/biases")
    filters, bias = (
        net.weight(prefix + "/conv/filters") * scale,
        net.weight(prefix + "/conv/bias") * scale + shift,
    )
    return net.convolution(value, filters, bias, stride, padding)


def _residual(net: FaceApiNetwork, value: str, prefix: str) -> str:
    inner = net.relu(_scaled_convolution(net, value, prefix + "/conv1"))
    return net.relu(net.add(_scaled_convolution(net, inner, prefix + "/conv2"), value))


def _residual_down(net: FaceApiNetwork, value: str, prefix: str, size: int, channels: int) -> Sequence[Any]:
    """Residual block of half the size; returns the value, its new size and its new channels.

    The skip path is average pooled; the smaller one of both paths is filled with zeros at the bottom and
    right, and missing channels with zeros.
    """
    inner = net.relu(_scaled_convolution(net, value, prefix + "/conv1", 2, "VALID"))
    inner = _scaled_convolution(net, inner, prefix + "/conv2")
    skip = net.build.node("AveragePool", [value], kernel_shape=[2, 2], strides=[2, 2])
    new_channels = net.weight(prefix + "/conv2/conv/filters").shape[3]
    inner_size, skip_size = (size - 3) // 2 + 1, (size - 2) // 2 + 1
    if skip_size != inner_size:
        inner = net.build.node("Pad", [inner, net.build.integers([0, 0, 0, 0, 0, 0, 1, 1])])
    if new_channels != channels:
        skip = net.build.node(
            "Pad", [skip, net.build.integers([0, 0, 0, 0, 0, new_channels - channels, 0, 0])]
        )
    return net.relu(net.add(skip, inner)), skip_size, new_channels


def _recognition(net: FaceApiNetwork) -> None:
    value = net.relu(_scaled_convolution(net, net.image, "conv32_down", 2, "VALID"))
    value = net.build.node("MaxPool", [value], kernel_shape=[3, 3], strides=[2, 2])
    size = ((SIZES["face_recognition"] - 7) // 2 + 1 - 3) // 2 + 1
    channels = 32
    for stage, blocks in (("conv32", 3), ("conv64", 3), ("conv128", 2), ("conv256", 2)):
        if stage != "conv32":
            value, size, channels = _residual_down(net, value, stage + "_down", size, channels)
        for block in range(1, blocks + 1):
            value = _residual(net, value, "%s_%d" % (stage, block))
    value, size, channels = _residual_down(net, value, "conv256_down_out", size, channels)
    value = net.build.node("Flatten", [net.build.node("GlobalAveragePool", [value])])
    net.build.output(
        "embedding", net.build.node("MatMul", [value, net.build.floats(net.weight("fc"))]), ["N", 128]
    )


_NETWORKS: Dict[str, Callable[[FaceApiNetwork], None]] = {
    "age_gender": _age_gender,
    "face_expression": _expression,
    "face_recognition": _recognition,
}
