"""Small world models, rewards and files for the tests, made here as the page on formats says."""

import json
import struct

import numpy as np

TYPES = {"float32": "F32", "float16": "F16", "float64": "F64", "uint32": "U32"}


def safetensors(tensors, metadata=None):
    """The bytes of a file. A tensor may be a pair of a type and an array of its bits."""
    header, data = {}, b""
    if metadata is not None:
        header["__metadata__"] = metadata
    for name, tensor in tensors.items():
        dtype, values = tensor if isinstance(tensor, tuple) else (TYPES[str(tensor.dtype)], tensor)
        start, data = len(data), data + values.tobytes()
        header[name] = {"dtype": dtype, "shape": list(values.shape), "data_offsets": [start, len(data)]}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + data


def write(path, tensors, metadata=None):
    path.write_bytes(safetensors(tensors, metadata))
    return path


AXES = [{"name": "reach", "low": 0.0, "high": 512.0, "neutral": 256.0}, {"name": "turn", "low": -2.0, "high": 1.0}]
LAYERS = [{"channels": 4, "kernel": 4, "stride": 2, "padding": 1}, {"channels": 6, "kernel": 3, "stride": 1, "padding": 0}]


def world(path, seed=0, axes=AXES, **of_world):
    """A world model of pictures of 12 by 16, that are not square, and of two axes, neither of which begins at -1 or ends at 1."""
    rng = np.random.default_rng(seed)
    height, width, z, m, k, a = 12, 16, 3, 5, 2, len(axes)
    decoder = [{"channels": 4, "kernel": 3, "stride": 1, "padding": 0}, {"channels": 3, "kernel": 4, "stride": 2, "padding": 1}]
    n_bottom = 6 * 4 * 6
    shapes = {
        "vae.conv1": (4, 3, 4, 4),
        "vae.conv2": (6, 4, 3, 3),
        "vae.fc_mu": (z, n_bottom),
        "vae.fc_logvar": (z, n_bottom),
        "vae.dec_fc": (n_bottom, z),
        "vae.deconv1": (6, 4, 3, 3),
        "vae.deconv2": (4, 3, 4, 4),
        "mdn_rnn.head": (3 * k * z, m),
    }
    tensors = {}
    for name, shape in shapes.items():
        n_out = shape[1] if "deconv" in name else shape[0]
        tensors[name + ".weight"] = rng.normal(0, 0.4, shape)
        tensors[name + ".bias"] = rng.normal(0, 0.1, n_out)
    for part, n_in in [("ih", z + a), ("hh", m)]:
        tensors["mdn_rnn.lstm.weight_" + part] = rng.normal(0, 0.3, (4 * m, n_in))
        tensors["mdn_rnn.lstm.bias_" + part] = rng.normal(0, 0.1, 4 * m)
    for part, n in [("z", z), ("c", m), ("h", m)]:
        tensors["starts." + part] = rng.normal(0, 1, (4, n))
    config = {
        "layout": 2,
        "env": "arm",
        "vae": {"height": height, "width": width, "latent": z, "encoder": LAYERS, "decoder": decoder, "free_bits": 0.1},
        "mdn_rnn": {"latent": z, "memory": m, "components": k},
    }
    metadata = {"config": json.dumps(config), "world": json.dumps({"axes": axes, **of_world})}
    return write(path, {name: value.astype(np.float32) for name, value in tensors.items()}, metadata)


def reward(path, seed=1, key="reward", outputs=1, n_features=13, n_actions=2, **config):
    """A reward of two members over the features of that world model."""
    rng = np.random.default_rng(seed)
    config = {"members": 2, "hidden": 7, "layers": 2, **config}
    tensors, n_in = {}, n_features + n_actions
    for i in range(3):
        n_out = outputs if i == 2 else 7
        tensors[f"{key}.{i}.weight"] = rng.normal(0, 0.4, (2, n_out, n_in)).astype(np.float32)
        tensors[f"{key}.{i}.bias"] = rng.normal(0, 0.1, (2, n_out)).astype(np.float32)
        n_in = n_out
    told = {"layout": 2, "config": config, "n_features": n_features, "world_model": "sha256:0"}
    return write(path, tensors, {key: json.dumps(told)})
