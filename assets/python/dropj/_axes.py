"""What an action's numbers are called, and their ranges."""

import json

import numpy as np

# Files made before worlds had files are of the car.
_CAR = [("steer", -1.0, 1.0), ("gas", 0.0, 1.0), ("brake", 0.0, 1.0)]
_LONGEST = 1000
_RATE = 50.0


class Axes:
    """names, low and high of an action's numbers."""

    def __init__(self, axes):
        self.names = [name for name, _, _ in axes]
        self.low = np.array([low for _, low, _ in axes], np.float32)
        self.high = np.array([high for _, _, high in axes], np.float32)
        if not (np.isfinite([self.low, self.high]).all() and (self.low < self.high).all()):
            raise ValueError("an axis of its world does not go from a number to a larger one")

    def __len__(self):
        return len(self.names)

    def __repr__(self):
        ranges = (f"{name} {low:g} to {high:g}" for name, low, high in zip(self.names, self.low, self.high))
        return f"Axes({', '.join(ranges)})"


def world_of(metadata, config):
    """The world that a file's header tells of, as a dict; an empty one where it tells of none."""
    told = metadata.get("world", config.get("world"))
    if told is None and "ranges" in config:  # of a reward
        told = {"axes": [{"low": low, "high": high} for low, high in config["ranges"]]}
    if isinstance(told, str):
        told = _parsed(told)
    if told is not None and not isinstance(told, dict):
        raise ValueError("the world in its header is no object")
    return told or {}


def axes_of(world, n):
    """The axes of a world, which must be n."""
    axes = [
        (str(axis.get("name", f"axis {i + 1}")), float(axis["low"]), float(axis["high"]))
        for i, axis in enumerate(world.get("axes") or [])
    ]
    if not axes and n == len(_CAR):
        axes = _CAR
    if not axes:
        return None
    if len(axes) != n:
        raise ValueError(f"its world has {len(axes)} axes, and its networks take {n} numbers of an action")
    return Axes(axes)


def longest_episode(world):
    """Steps of an episode at the most."""
    return int(world.get("longest_episode") or _LONGEST)


def rate(world):
    """Steps a second."""
    return float(world.get("rate") or _RATE)


def _parsed(text):
    """A world as JSON, or as the TOML of its file."""
    try:
        return json.loads(text)
    except ValueError:
        pass
    try:
        import tomllib
    except ImportError:
        try:
            import tomli as tomllib
        except ImportError:
            raise ImportError("the world in its header is TOML, which takes Python 3.11 or the package tomli") from None
    return tomllib.loads(text)
