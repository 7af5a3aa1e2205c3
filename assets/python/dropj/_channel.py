"""Messages over standard input and output. Python's standard library alone."""

import json
import os
import struct
import sys
import traceback

PROTOCOL = 1
_LENGTHS = struct.Struct("<II")
_MOST = 1 << 20  # bytes of a header

_input = None
_output = None


def take():
    """Keeps standard input and output for the protocol; what anybody prints goes to standard error from here on."""
    global _input, _output
    if _output is not None:
        return
    _input = os.fdopen(os.dup(0), "rb")
    _output = os.fdopen(os.dup(1), "wb", buffering=0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    # Processes that this one starts are not spoken to.
    os.environ.pop("DROPJ_PROTOCOL", None)


def send(header, pixels=b""):
    """Sends a message. Numbers that are none cannot be sent: ValueError."""
    text = json.dumps(header, allow_nan=False).encode()
    message = memoryview(_LENGTHS.pack(len(text), len(pixels)) + text + pixels)
    while message:
        message = message[_output.write(message):]


def requests():
    """What dropj asks for, one after the other, up to its end."""
    while True:
        lengths = _exactly(_LENGTHS.size)
        if lengths is None:
            return
        n_header, n_pixels = _LENGTHS.unpack(lengths)
        if n_header > _MOST or n_pixels:
            raise ValueError(f"a request of {n_header} and {n_pixels} bytes is not of this protocol")
        header = _exactly(n_header)
        if header is None:
            return
        request = json.loads(header)
        if request["type"] == "close":
            return
        yield request


def _exactly(n):
    """The next n bytes; None where dropj has gone."""
    data = _input.read(n)
    return data if len(data) == n else None


def report(error):
    """Tells dropj of an error, with its traceback."""
    lines = traceback.format_exception(type(error), error, error.__traceback__)
    message = traceback.format_exception_only(type(error), error)[-1].strip()
    try:
        send({"type": "error", "message": message[-10_000:], "traceback": "".join(lines)[-60_000:]})
    except OSError:
        sys.stderr.write("".join(lines))


# Started by dropj: before anything is imported that prints.
if "DROPJ_PROTOCOL" in os.environ:
    take()
