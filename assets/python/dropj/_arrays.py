"""Files of arrays, safetensors, read within bounds: a header in JSON and the bytes of all numbers. Needs NumPy."""

import hashlib
import json
import os
import struct

import numpy as np

# As src/tensor/limits.rs of the program has them.
_MOST_HEADER = 1 << 20
_MOST_TENSORS = 4096
_MOST_AXES = 8

# What each number is, in the file and here. BF16 is the upper half of an F32, which NumPy has no name for.
_TYPES = {"F64": "<f8", "F32": "<f4", "F16": "<f2", "BF16": "<u2", "U32": "<u4"}


def read(path):
    """The texts of a file's header, and its arrays by name: F64, F32, F16 and BF16 as float32, U32 as it is.

    What is not such a file, or holds a number that is infinite or none, is refused with a ValueError.
    """
    path = os.fspath(path)
    try:
        with open(path, "rb") as file:
            metadata, entries, start = _header(file)
            data = np.fromfile(file, np.uint8)
        _check_places(entries, data.size)
        return metadata, {name: _array(name, entry, data) for name, entry in entries.items()}
    except ValueError as error:
        raise ValueError(f"{error}: {path}") from None


def metadata(path):
    """The texts of a file's header alone."""
    with open(path, "rb") as file:
        return _header(file)[0]


def sha256(path):
    """What the program calls a file: sha256: and 64 digits."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        for part in iter(lambda: file.read(1 << 20), b""):
            digest.update(part)
    return "sha256:" + digest.hexdigest()


def described(metadata, key):
    """What the JSON under this key tells, without the mark of its layout, and the layout."""
    if key not in metadata:
        raise ValueError(f"the header tells nothing of {key!r}")
    told = _json(metadata[key])
    if not isinstance(told, dict):
        raise ValueError(f"{key!r} in the header is no object")
    layout = told.pop("layout", 1)
    if layout not in (1, 2):
        raise ValueError(f"its layout is {layout!r}, and 1 and 2 are known here")
    return told, layout


def _header(file):
    lead = file.read(8)
    if lead.startswith(b"version "):
        raise ValueError("it is a pointer of Git LFS and not the file itself, which `git lfs pull` fetches")
    if lead.startswith(b"PK\x03\x04"):
        raise ValueError("it is a zip, as PyTorch's own files are, and no safetensors")
    if len(lead) < 8:
        raise ValueError(f"{len(lead)} bytes are too few")
    (n,) = struct.unpack("<Q", lead)
    if n > _MOST_HEADER:
        raise ValueError(f"its header is said to have {n} bytes, and at most {_MOST_HEADER} are read")
    text = file.read(n)
    if len(text) < n:
        raise ValueError("it is cut short within its header")
    header = _json(text)
    if not isinstance(header, dict):
        raise ValueError("its header is no object")
    metadata = header.pop("__metadata__", None) or {}
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise ValueError("__metadata__ holds more than texts")
    if len(header) > _MOST_TENSORS:
        raise ValueError(f"it has more than {_MOST_TENSORS} tensors")
    return metadata, header, 8 + n


def _json(text):
    try:
        return json.loads(text, object_pairs_hook=_named_once)
    except (RecursionError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"its header cannot be read: {error}") from None


def _named_once(pairs):
    fields = dict(pairs)
    if len(fields) < len(pairs):
        raise ValueError("a name is there twice in its header")
    return fields


def _is_count(value):
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _check_places(entries, n_there):
    """Whether all arrays lie side by side and fill the file, each as its type and shape want."""
    places = []
    for name, entry in entries.items():
        try:
            dtype, shape, (start, end) = entry["dtype"], entry["shape"], entry["data_offsets"]
        except (KeyError, TypeError, ValueError):
            raise ValueError(f"{name!r} is not described as a tensor") from None
        if dtype not in _TYPES:
            raise ValueError(f"{name!r} is of the type {dtype!r}, and what is read is {', '.join(_TYPES)}")
        if not isinstance(shape, list) or len(shape) > _MOST_AXES or not all(map(_is_count, [*shape, start, end])):
            raise ValueError(f"{name!r} has no shape and place that can be")
        n = int(_TYPES[dtype][-1])
        for size in shape:
            n *= size
        if n != end - start:
            raise ValueError(f"{name!r} of the shape {shape} does not have {end - start} bytes")
        places.append((start, end, name))
    at = 0
    for start, end, name in sorted(places):
        if start != at:
            raise ValueError(f"{name!r} does not begin where the tensor before it ends")
        at = end
    if at != n_there:
        raise ValueError(f"its tensors have {at} bytes, and {n_there} are there")


def _array(name, entry, data):
    start, end = entry["data_offsets"]
    values = data[start:end].copy().view(_TYPES[entry["dtype"]])
    if entry["dtype"] == "BF16":
        values = (values.astype(np.uint32) << 16).view(np.float32)
    elif entry["dtype"] != "U32":
        values = values.astype(np.float32, copy=False)
    if values.dtype == np.float32 and not np.isfinite(values).all():
        raise ValueError(f"{name!r} holds a number that is infinite or none (NaN)")
    return values.reshape(entry["shape"])
