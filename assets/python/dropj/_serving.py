"""A gymnasium.Env, or what looks like one, as a world of dropj. Needs NumPy."""

import inspect
import math
import sys

from . import _channel

_MOST_FIELDS = 200


class Box:
    """What can be done: a number from low to high for each axis. In place of gymnasium.spaces.Box where there is none."""

    def __init__(self, low, high, names=None, neutral=None):
        import numpy as np

        self.low = np.asarray(low, np.float32)
        self.high = np.asarray(high, np.float32)
        self.shape, self.dtype = self.low.shape, self.low.dtype
        self.names, self.neutral = names, neutral


def serve(
    env, *, axes=None, neutral=None, size=None, pixels=None, hertz=None, fields=None, safety=(), progress=(), policy=None,
    executed=None, name=None,
):
    """Serves env until dropj ends it.

    env       a gymnasium.Env, or what has its action_space, reset and step; or a function that makes one
    axes      names of the action's numbers
    neutral   their values while nobody does anything; where it is not said, dropj takes 0 if that is in range
    size      (height, width) that pictures are shrunk to here; where it is not said, they are sent as they are
    pixels    where pictures come from: "observation", "render", the key of an observation that is a dict, or a
              function of env and observation; where it is not said, whichever is a picture
    hertz     steps a second of the world's time; metadata["render_fps"] is often another number
    fields    more that can be told of a step than is in info: {name: function of env}
    safety    fields that say that something bad happens, progress: that something good does; for a first world.toml
    policy    what would be done here, for recordings: a function of env and a random generator of NumPy that the seed of
              the episode decides, or an object with reset(env, rng) and act(env); each returns an action
    executed  what was executed in a step, where that is not what was asked (a safety filter, a human at the robot): an
              entry of info, or a function of env; None where it was
    """
    _channel.take()
    try:
        if isinstance(env, type) or not hasattr(env, "step"):
            env = env()
        world = _World(env, axes, neutral, size, pixels, hertz, fields or {}, safety, progress, policy, executed, name)
        _channel.send(world.hello())
        for request in _channel.requests():
            if request["type"] == "reset":
                header, picture = world.reset(request["seed"], request.get("fields", []))
            elif request["type"] == "step":
                header, picture = world.step(request["action"])
            elif request["type"] == "act":
                header, picture = world.act(), b""
            else:
                raise ValueError(f"there is no request {request['type']!r}")
            _channel.send({"n": request["n"], **header}, picture)
    except BrokenPipeError:
        pass  # dropj has gone
    except Exception as error:
        _channel.report(error)
        sys.exit(1)
    finally:
        if hasattr(env, "close"):
            env.close()


class _World:
    def __init__(self, env, axes, neutral, size, pixels, hertz, fields, safety, progress, policy, executed, name):
        import numpy

        self.np, self.env, self.size, self.pixels = numpy, env, size, pixels
        self.hertz, self.extra, self.told = hertz, fields, []
        self.safety, self.progress, self.name = safety, progress, name
        self.policy, self.executed, self.advice = _policy(policy), executed, None
        self.weights, self.takes_seed = {}, True
        self.space = _box(numpy, env.action_space)
        self.low = numpy.asarray(self.space.low, float).ravel()
        self.high = numpy.asarray(self.space.high, float).ravel()
        names = axes or getattr(self.space, "names", None)
        self.names = list(names or (f"axis {i + 1}" for i in range(len(self.low))))
        self.neutral = neutral if neutral is not None else getattr(self.space, "neutral", None)
        for what, given in [("axes", self.names), ("neutral", self.neutral)]:
            if given is not None and len(given) != len(self.low):
                raise ValueError(f"{what} has {len(given)} entries, and an action has {len(self.low)} numbers")
        # A robot has no seed.
        if "seed" not in inspect.signature(env.reset).parameters:
            kinds = [p.kind for p in inspect.signature(env.reset).parameters.values()]
            self.takes_seed = inspect.Parameter.VAR_KEYWORD in kinds

    def hello(self):
        spec, metadata = getattr(self.env, "spec", None), getattr(self.env, "metadata", None) or {}
        height, width = self.picture_size()
        neutral = self.neutral if self.neutral is not None else [None] * len(self.names)
        axes = [
            {"name": str(name), "low": float(low), "high": float(high), "neutral": None if rest is None else float(rest)}
            for name, low, high, rest in zip(self.names, self.low, self.high, neutral)
        ]
        events = [
            {"name": field.split(".")[-1].replace("_", " "), "kind": kind, "field": field}
            for kind, all_fields in [("safety", self.safety), ("progress", self.progress)]
            for field in all_fields
        ]
        return {
            "type": "hello",
            "protocol": _channel.PROTOCOL,
            "name": self.name or getattr(spec, "id", None) or type(self.env).__name__,
            "image": {"height": height, "width": width},
            "axes": axes,
            "hertz": self.hertz,
            "render_fps": _scalar_or_none(metadata.get("render_fps")),
            "longest_episode": getattr(spec, "max_episode_steps", None),
            "events": events,
            "versions": _versions(self.env),
            "policy": self.policy is not None,
        }

    def picture_size(self):
        """Without a reset where that can be told, as it moves a robot."""
        if self.size is not None:
            return tuple(int(side) for side in self.size)
        return self.picture(self.first(0)[0]).shape[:2]

    def first(self, seed):
        # Many worlds take no seed of more than 32 bits.
        observed = self.env.reset(seed=seed % 2**32) if self.takes_seed else self.env.reset()
        return observed if isinstance(observed, tuple) else (observed, {})

    def reset(self, seed, fields):
        self.told, self.advice = fields, None
        observed, info = self.first(seed)
        if self.policy is not None:
            # Another stream than the world's own, which the same seed decides.
            self.policy.reset(self.env, self.np.random.default_rng([seed, 1]))
        return self.frame(observed, None, False, False, info)

    def act(self):
        if self.policy is None:
            raise ValueError("this world has no policy")
        if self.advice is None:  # asked twice at one moment, it says the same
            self.advice = self.action(self.policy.act(self.env), "the policy's action")
        return {"type": "action", "action": self.advice}

    def action(self, action, what):
        """An action as JSON has it."""
        action = self.np.asarray(action, float).ravel()
        if len(action) != len(self.low) or not self.np.isfinite(action).all():
            raise ValueError(f"{what} is {action.tolist()}, and {len(self.low)} finite numbers are needed")
        return action.tolist()

    def step(self, action):
        self.advice = None
        action = self.np.asarray(action, self.space.dtype).reshape(self.space.shape)
        result = self.env.step(action)
        if len(result) == 6:  # safety-gymnasium has costs beside rewards
            observed, reward, cost, terminated, truncated, info = result
            info = {"cost": cost, **info}
        elif len(result) == 5:
            observed, reward, terminated, truncated, info = result
        else:
            raise ValueError(f"step returns {len(result)} values, and gymnasium's five are needed")
        header, picture = self.frame(observed, reward, terminated, truncated, info)
        if self.executed is not None:
            done = self.executed(self.env) if callable(self.executed) else _found(info, self.executed)
            header["action"] = None if done is None else self.action(done, "the executed action")
        return header, picture

    def frame(self, observed, reward, terminated, truncated, info):
        picture = self.picture(observed)
        if reward is not None:
            reward = float(reward)
            if not math.isfinite(reward):
                raise ValueError(f"the reward is {reward}")
        header = {
            "type": "frame",
            "height": picture.shape[0],
            "width": picture.shape[1],
            "reward": reward,
            "terminated": bool(terminated),
            "truncated": bool(truncated),
            "fields": self.fields(info),
        }
        # Pictures may be views with steps of any kind.
        return header, self.np.ascontiguousarray(picture).tobytes()

    def fields(self, info):
        if self.told == ["*"]:
            told = {}
            _flatten(self.np, info, "", told)
            told.update((name, _scalar(self.np, name, value(self.env))) for name, value in self.extra.items())
            return told
        told = {}
        for name in self.told:
            value = self.extra[name](self.env) if name in self.extra else _found(info, name)
            told[name] = _scalar(self.np, name, value)
        return told

    def picture(self, observed):
        if callable(self.pixels):
            picture = self.pixels(self.env, observed)
        elif self.pixels == "render":
            picture = self.env.render()
        elif self.pixels == "observation":
            picture = observed
        elif self.pixels is not None:
            picture = observed[self.pixels]
        else:
            pictures = observed.values() if isinstance(observed, dict) else [observed]
            picture = next((one for one in pictures if _is_picture(self.np, one)), None)
            picture = self.env.render() if picture is None else picture
        if not _is_picture(self.np, picture):
            raise TypeError(
                f"there is no picture but {_kind(picture)}: an array of unsigned bytes [height, width, 3] is needed, as "
                'observation or from render (render_mode="rgb_array"); or say where it is by pixels'
            )
        if picture.shape[2] not in (3, 4):
            picture = picture.transpose(1, 2, 0)
        return self.shrunk(picture[:, :, :3])

    def shrunk(self, picture):
        """Each pixel the mean of the area that it covers."""
        if self.size is None or picture.shape[:2] == tuple(self.size):
            return picture
        rows, columns = (self.areas(n, to) for n, to in zip(picture.shape[:2], self.size))
        small = self.np.tensordot(rows, picture.astype(self.np.float32), 1)  # [height, columns, 3]
        small = self.np.tensordot(columns, small, (1, 1)).transpose(1, 0, 2)
        return (small + 0.5).astype(self.np.uint8)

    def areas(self, n, to):
        if (n, to) not in self.weights:
            edges = self.np.arange(to + 1) * (n / to)
            low, high = edges[:-1, None], edges[1:, None]
            pixels = self.np.arange(n)
            shared = self.np.minimum(high, pixels + 1) - self.np.maximum(low, pixels)
            self.weights[n, to] = (self.np.clip(shared, 0, None) * (to / n)).astype(self.np.float32)
        return self.weights[n, to]


class _Function:
    """A policy that is a function."""

    def __init__(self, function):
        self.function = function

    def reset(self, env, rng):
        self.rng = rng

    def act(self, env):
        return self.function(env, self.rng)


def _policy(policy):
    if isinstance(policy, type):
        policy = policy()
    if policy is None or hasattr(policy, "act"):
        return policy
    if not callable(policy):
        raise TypeError(f"the policy is {_kind(policy)}: a function of env and rng is needed, or an object with reset and act")
    return _Function(policy)


def _box(np, space):
    """The space, where an action is some numbers in ranges."""
    if not hasattr(space, "low") or not hasattr(space, "high"):
        raise TypeError(
            f"the actions are {type(space).__name__}, and dropj needs numbers in ranges (Box): its method imagines and compares "
            "continuous actions. A wrapper can offer axes, such as turning from -1 to 1, and choose by their thirds"
        )
    if not (np.isfinite(space.low).all() and np.isfinite(space.high).all()):
        raise TypeError("an axis of the actions has no bounds; a wrapper such as gymnasium's RescaleAction gives it some")
    if np.issubdtype(space.dtype, np.integer):
        raise TypeError("the actions are whole numbers, and dropj needs continuous ones")
    return space


def _kind(value):
    shape = getattr(value, "shape", None)
    return f"{type(value).__name__}" + (f" of shape {tuple(shape)}, {value.dtype}" if shape is not None else "")


def _is_picture(np, value):
    return (
        isinstance(value, np.ndarray)
        and value.dtype == np.uint8
        and value.ndim == 3
        and (value.shape[2] in (3, 4) or value.shape[0] == 3)
    )


def _scalar(np, name, value):
    """A number or truth value as JSON has it; None for what is none yet."""
    if isinstance(value, (np.ndarray, np.generic)) and value.size == 1:
        value = value.item()
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    raise TypeError(f"the field {name!r} is {_kind(value)}, and a number or truth value is needed")


def _scalar_or_none(value):
    return value if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _found(info, name):
    """The value in info, or in a dict within it: "rewards.on_road"."""
    if name in info:
        return info[name]
    first, _, rest = name.partition(".")
    inner = info.get(first)
    return _found(inner, rest) if rest and isinstance(inner, dict) else None


def _flatten(np, info, before, told):
    for key, value in info.items():
        if isinstance(value, dict):
            _flatten(np, value, f"{before}{key}.", told)
        elif len(told) < _MOST_FIELDS:
            try:
                told[f"{before}{key}"] = _scalar(np, key, value)
            except TypeError:
                pass


def _versions(env):
    from importlib import metadata

    versions = {"python": sys.version.split()[0]}
    packages = ["numpy", "gymnasium", type(getattr(env, "unwrapped", env)).__module__.split(".")[0]]
    for package in packages:
        try:
            versions[package] = metadata.version(package)
        except (metadata.PackageNotFoundError, ValueError):
            pass
    return versions
