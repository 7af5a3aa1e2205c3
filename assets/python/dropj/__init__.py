"""Serves a world to the program dropj: any gymnasium.Env with pixels, or a robot. And reads what dropj made.

    import dropj            # before what may print
    import gymnasium

    dropj.serve(gymnasium.make("CarRacing-v3"))

    world = dropj.load_world("world.safetensors")
    reward = dropj.load_reward("reward/0000.safetensors")
    session = dropj.read_session("sessions/mine")

README.md beside this has all of it, and the protocol byte by byte.
"""

from . import _channel  # first: where dropj started us, standard output is the protocol's from here on

from ._serving import Box, serve

# Where a name is, for all that takes NumPy: nothing is imported before it is asked for.
_LATER = {
    "load_world": "_world_model",
    "WorldModel": "_world_model",
    "State": "_world_model",
    "load_reward": "_reward",
    "Reward": "_reward",
    "SparseReward": "_reward",
    "read_session": "_session",
    "Session": "_session",
    "DreamEnv": "_environments",
    "RewardWrapper": "_environments",
}

__all__ = ["Box", "serve"]
PROTOCOL = _channel.PROTOCOL


def __getattr__(name):
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module("." + _LATER[name], __name__), name)
    globals()[name] = value
    return value


def __dir__():
    return sorted({*globals(), *_LATER})
