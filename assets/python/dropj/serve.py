"""python -m dropj.serve ID: serves a world of gymnasium by its name, without a line of code."""

from . import _channel

import argparse
import importlib
import json
import os
import sys
import types


def main():
    parser = argparse.ArgumentParser(prog="python -m dropj.serve", description="Serves a world of gymnasium to dropj.")
    parser.add_argument("id", help="as gymnasium.make takes it, such as CarRacing-v3 or gym_pusht/PushT-v0")
    parser.add_argument("--config", type=_object, default={}, metavar="JSON", help="arguments for gymnasium.make")
    parser.add_argument("--import", dest="modules", action="append", default=[], metavar="MODULE", help="import first")
    parser.add_argument("--wrap", metavar="FILE:FUNCTION", help="a function of a Python file that takes and returns the env")
    parser.add_argument("--size", type=_size, metavar="HxW", help="shrink pictures to this size")
    parser.add_argument("--pixels", help="observation, render, or the key of an observation")
    parser.add_argument("--hertz", type=float, help="steps a second of the world's time")
    parser.add_argument("--axes", type=_names, metavar="A,B", help="names of the action's numbers")
    parser.add_argument("--neutral", type=_numbers, metavar="A,B", help="the action while nobody does anything")
    parser.add_argument("--safety", type=_names, default=[], metavar="A,B", help="fields of info that say what is bad")
    parser.add_argument("--progress", type=_names, default=[], metavar="A,B", help="fields of info that say what is good")
    parser.add_argument("--policy", metavar="FILE:FUNCTION", help="a function of env and rng that returns an action, for recordings")
    parser.add_argument("--executed", metavar="A", help="the entry of info that says what was executed in place of the action")
    options = parser.parse_args()
    if "DROPJ_PROTOCOL" not in os.environ and _channel._output is None and sys.stdin.isatty():
        parser.error("this is started by dropj: dropj world new --process 'python -m dropj.serve " + options.id + "'")

    from ._serving import serve

    serve(
        lambda: _make(options),
        axes=options.axes,
        neutral=options.neutral,
        size=options.size,
        pixels=options.pixels,
        hertz=options.hertz,
        safety=options.safety,
        progress=options.progress,
        policy=_named(options.policy) if options.policy else None,
        executed=options.executed,
        name=options.id,
    )


def _object(text):
    try:
        found = json.loads(text)
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise argparse.ArgumentTypeError(f"{text} is no object of JSON, such as '{{\"continuous\": true}}'; mind the quotes")
    return found


def _numbers(text):
    try:
        return json.loads(f"[{text.strip().removeprefix('[').removesuffix(']')}]")
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} are no numbers, such as 0,0.5") from None


def _make(options):
    for module in options.modules:
        importlib.import_module(module)
    import gymnasium

    if "/" in options.id and ":" not in options.id and options.id not in gymnasium.registry:
        importlib.import_module(options.id.split("/")[0])
    try:
        env = gymnasium.make(options.id, **{"render_mode": "rgb_array", **options.config})
    except TypeError:  # it takes no render_mode
        env = gymnasium.make(options.id, **options.config)
    if options.wrap:
        env = _named(options.wrap)(env)
    return env


def _named(text):
    """What FILE:FUNCTION names."""
    path, _, name = text.rpartition(":")
    module = types.ModuleType("dropj_" + os.path.splitext(os.path.basename(path))[0])
    module.__file__ = path
    sys.modules[module.__name__] = module
    with open(path) as file:
        exec(compile(file.read(), path, "exec"), module.__dict__)
    return getattr(module, name)


def _size(text):
    height, width = (int(side) for side in text.lower().split("x"))
    return height, width


def _names(text):
    return [name.strip() for name in text.split(",")]


class _Callable(types.ModuleType):
    """So that dropj.serve(env) is right whether this module was imported or not."""

    def __call__(self, *args, **kwargs):
        from ._serving import serve

        return serve(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    main()
