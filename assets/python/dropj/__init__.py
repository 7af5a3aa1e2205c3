"""Serves a world to the program dropj: any gymnasium.Env with pixels, or a robot.

    import dropj            # before what may print
    import gymnasium

    dropj.serve(gymnasium.make("CarRacing-v3"))

README.md beside this has all of it, and the protocol byte by byte.
"""

from . import _channel  # first: where dropj started us, standard output is the protocol's from here on

from ._serving import Box, serve

__all__ = ["Box", "serve"]
PROTOCOL = _channel.PROTOCOL
