"""A world model of dropj: what it observes, remembers, imagines and paints. Needs NumPy; PyTorch makes it quick."""

import math
import os
from typing import NamedTuple

import numpy as np

from . import _arrays
from ._axes import axes_of, longest_episode, rate, world_of
from ._networks import Network


class State(NamedTuple):
    """Latents, and the memory before it takes in these latents and the action to come. Batches stand in front."""

    z: object  # [..., Z]
    c: object  # [..., M]
    h: object  # [..., M]

    @property
    def features(self):
        """[z | c | h], which rewards read: [..., Z + 2 M]."""
        if isinstance(self.z, np.ndarray):
            return np.concatenate(self, -1)
        import torch

        return torch.cat([torch.as_tensor(part, device=self.z.device) for part in self], -1)

    def at(self, index):
        """These states of a batch."""
        return State(self.z[index], self.c[index], self.h[index])


class Mixture(NamedTuple):
    """A mixture of K Gaussians for each latent by itself. All are [..., Z, K]."""

    log_weights: object
    mean: object
    log_deviation: object


def load_world(path, *, backend=None, device=None):
    """The world model in a file. backend is "torch" or "numpy", device one of PyTorch's; PyTorch is taken where it is."""
    return WorldModel(path, backend=backend, device=device)


class WorldModel(Network):
    """A world model.

    config     what its header tells
    env        the world whose recordings it learned from
    size       (height, width) of its pictures
    n_latents, n_memory, n_features   Z, M and Z + 2 M
    axes       names, low and high of an action's numbers
    rate, longest_episode   steps a second, and of an episode at the most
    starts     a State of arrays [n, ...] in which dreams may start; of no rows where the file has none
    held_out   numbers of the recorded episodes that it was never trained on, or None
    hash       by which sessions and rewards name it
    """

    def __init__(self, path, *, backend=None, device=None):
        self.path = os.fspath(path)
        metadata, tensors = _arrays.read(path)
        try:
            self.config, layout = _arrays.described(metadata, "config")
            parameters = self._understood(metadata, layout, tensors)
        except (KeyError, TypeError, ValueError, IndexError) as error:
            what = f"no {error}" if isinstance(error, KeyError) else error
            raise ValueError(f"this is not a world model as it should be ({what}): {path}") from None
        super().__init__(parameters, backend, device)
        self._hash = None

    def _understood(self, metadata, layout, tensors):
        vae, memory = self.config["vae"], self.config["mdn_rnn"]
        self.env = self.config["env"]
        self.size = (vae.get("height", vae.get("side")), vae.get("width", vae.get("side")))
        self.n_latents, self.n_memory, self.n_components = vae["latent"], memory["memory"], memory["components"]
        self.n_features = self.n_latents + 2 * self.n_memory
        self.n_actions = tensors["mdn_rnn.lstm.weight_ih"].shape[1] - self.n_latents
        world = world_of(metadata, self.config)
        self.axes = axes_of(world, self.n_actions)
        self.longest_episode, self.rate = longest_episode(world), rate(world)
        self._encoder, self._decoder = vae["encoder"], vae["decoder"]
        self._bottom = tuple(_shrunk(side, self._encoder)[-1] for side in self.size)
        self._more = list(zip(*(_output_padding(side, self._encoder, self._decoder) for side in self.size)))

        starts = [tensors.get("starts." + part) for part in "zch"]
        if all(part is not None for part in starts):
            self.starts = State(*starts)
        else:
            self.starts = State(*(np.zeros((0, n), np.float32) for n in (self.n_latents, self.n_memory, self.n_memory)))
        held_out = tensors.get("held_out")
        self.held_out = None if held_out is None else [int(episode) for episode in held_out]

        shapes = dict(self._shapes())
        if layout == 1:
            tensors = {name: _relaid(name, value, shapes.get(name, ())) for name, value in tensors.items()}
        for name, shape in shapes.items():
            if tensors[name].shape != shape:
                raise ValueError(f"{name!r} has the shape {tensors[name].shape}, and {shape} is wanted")
        z, m = self.n_latents, self.n_memory
        for part, width in zip(self.starts, (z, m, m)):
            if part.shape != (len(self.starts.z), width):
                raise ValueError("its states to start from are not of its width")
        return {name: np.ascontiguousarray(tensors[name]) for name in shapes}

    def _shapes(self):
        """The shape of each tensor in PyTorch's layout."""
        z, m = self.n_latents, self.n_memory
        n = 3
        for i, layer in enumerate(self._encoder):
            k, n_out = layer["kernel"], layer["channels"]
            yield f"vae.conv{i + 1}.weight", (n_out, n, k, k)
            yield f"vae.conv{i + 1}.bias", (n_out,)
            n = n_out
        n_bottom = n * self._bottom[0] * self._bottom[1]
        for name, shape in [("fc_mu", (z, n_bottom)), ("dec_fc", (n_bottom, z))]:
            yield f"vae.{name}.weight", shape
            yield f"vae.{name}.bias", shape[:1]
        for i, layer in enumerate(self._decoder):
            k, n_out = layer["kernel"], layer["channels"]
            yield f"vae.deconv{i + 1}.weight", (n, n_out, k, k)
            yield f"vae.deconv{i + 1}.bias", (n_out,)
            n = n_out
        for part, n_in in [("ih", z + self.n_actions), ("hh", m)]:
            yield f"mdn_rnn.lstm.weight_{part}", (4 * m, n_in)
            yield f"mdn_rnn.lstm.bias_{part}", (4 * m,)
        yield "mdn_rnn.head.weight", (3 * self.n_components * z, m)
        yield "mdn_rnn.head.bias", (3 * self.n_components * z,)

    @property
    def hash(self):
        if self._hash is None:
            self._hash = _arrays.sha256(self.path)
        return self._hash

    def observe(self, frames):
        """The latents of pictures, [B, H, W, 3]: bytes, or intensities from 0 to 1. Returns [B, Z]."""
        with self._computing(frames) as m:
            x = m.pixels(frames)
            if tuple(x.shape[-3:]) != (*self.size, 3):
                raise ValueError(f"pictures are {tuple(x.shape[-3:])}, and this world model sees {(*self.size, 3)}")
            lead = tuple(x.shape[:-3])
            x = x.reshape((-1, *self.size, 3))
            for i, layer in enumerate(self._encoder):
                x = m.relu(m.conv(x, *_of(m, f"vae.conv{i + 1}"), layer["stride"], layer["padding"]))
            z = m.linear(x.reshape((len(x), -1)), *_of(m, "vae.fc_mu"))
            return m.out(z.reshape((*lead, self.n_latents)))

    def intensities(self, z):
        """The pictures of latents before they become bytes, from 0 to 1: [B, H, W, 3]."""
        with self._computing(z) as m:
            return m.out(self._painted(m, m.taken(z)))

    def decode(self, z):
        """The pictures of latents, as bytes: [B, H, W, 3]."""
        with self._computing(z) as m:
            return m.out(m.bytes(self._painted(m, m.taken(z))))

    def _painted(self, m, z):
        lead = tuple(z.shape[:-1])
        x = m.linear(z.reshape((-1, self.n_latents)), *_of(m, "vae.dec_fc"))
        x = x.reshape((len(x), *self._bottom, -1))
        for i, layer in enumerate(self._decoder):
            x = m.relu(x) if i > 0 else x
            x = m.deconv(x, *_of(m, f"vae.deconv{i + 1}"), layer["stride"], layer["padding"], self._more[i])
        return m.sigmoid(x).reshape((*lead, *self.size, 3))

    def no_memory(self, *lead):
        """An empty memory, c and h, for a batch of this shape."""
        return np.zeros((*lead, self.n_memory), np.float32), np.zeros((*lead, self.n_memory), np.float32)

    def state_of(self, features):
        """The State whose features these are."""
        z, m = self.n_latents, self.n_memory
        return State(features[..., :z], features[..., z : z + m], features[..., z + m :])

    def remember(self, state, action):
        """The memory, c and h, after it has taken in a state and an action as driven, [..., A]."""
        with self._computing(*state, action) as m:
            c, h = self._remembered(m, state, action)
            return m.out(c), m.out(h)

    def _remembered(self, m, state, action):
        z, c, h = (m.taken(part) for part in state)
        x = m.concatenate([z, m.taken(action)])
        t = m.t
        gates = m.linear(x, t["mdn_rnn.lstm.weight_ih"], t["mdn_rnn.lstm.bias_ih"])
        gates = gates + m.linear(h, t["mdn_rnn.lstm.weight_hh"], t["mdn_rnn.lstm.bias_hh"])
        n = self.n_memory
        i, f, g, o = (gates[..., part * n : (part + 1) * n] for part in range(4))
        c = m.sigmoid(f) * c + m.sigmoid(i) * m.tanh(g)
        return c, m.sigmoid(o) * m.tanh(c)

    def expect(self, h):
        """What latents follow, from the output of a memory that has taken in the present: a Mixture."""
        with self._computing(h) as m:
            return Mixture(*map(m.out, self._mixture(m, m.taken(h))))

    def _mixture(self, m, h):
        out = m.linear(h, *_of(m, "mdn_rnn.head"))
        out = out.reshape((*out.shape[:-1], self.n_latents, 3, self.n_components))
        return m.log_softmax(out[..., 0, :]), out[..., 1, :], out[..., 2, :]

    def imagine(self, state, action, temperature=None, mode="mean", rng=None):
        """The State that follows a state under an action as driven, [..., A].

        mode         "mean": the mean of the mixture, as planners look ahead; "sample": a draw from it, as in dreams
        temperature  of the mixture; 0.1 for the mean and 1 for a draw where it is not said
        rng          a numpy.random.Generator, which a draw comes from
        """
        if mode not in ("mean", "sample"):
            raise ValueError(f'mode is {mode!r}, and must be "mean" or "sample"')
        if temperature is None:
            temperature = 0.1 if mode == "mean" else 1.0
        with self._computing(*state, action) as m:
            c, h = self._remembered(m, state, action)
            log_weights, mean, log_deviation = self._mixture(m, h)
            weights = m.softmax(log_weights / temperature)
            if mode == "mean":
                z = (weights * mean).sum(-1)
            else:
                rng = np.random.default_rng() if rng is None else rng
                shape = tuple(mean.shape[:-1])
                uniform, normal = m.taken(rng.random(shape)), m.taken(rng.standard_normal(shape))
                # The first component whose cumulative weight reaches u; rounding must not pass the last.
                component = m.clip((m.cumulative(weights) < uniform[..., None]).sum(-1), 0, self.n_components - 1)
                chosen = m.one_hot(component, self.n_components)
                deviation = m.exp((chosen * log_deviation).sum(-1))
                z = (chosen * mean).sum(-1) + deviation * (math.sqrt(temperature) * normal)
            return State(m.out(z), m.out(c), m.out(h))

    def features_along(self, start, zs, actions):
        """The features [T, Z + 2 M] of the T steps of a dream, and the State after its last action, of which z is imagined.

        The memory at every step follows from the start, the latents zs [T, Z] and the actions [T, A].
        """
        state, rows = State(*start), []
        for z, action in zip(zs, actions):
            state = State(z, state.c, state.h)
            rows.append(state.features)
            after = State(None, *self.remember(state, action))
            last, state = state, after
        if not rows:
            return np.zeros((0, self.n_features), np.float32), state
        return np.stack(rows), self.imagine(last, actions[-1])


def _of(m, name):
    return m.t[name + ".weight"], m.t[name + ".bias"]


def _shrunk(side, encoder):
    """Pixels along one axis, from the frame inwards."""
    sides = [side]
    for layer in encoder:
        sides.append((sides[-1] + 2 * layer["padding"] - layer["kernel"]) // layer["stride"] + 1)
    return sides


def _output_padding(side, encoder, decoder):
    """What each layer of the decoder paints beyond what it does by itself: see assets/FORMAT.md."""

    def grown(side, layer):
        return (side - 1) * layer["stride"] + layer["kernel"] - 2 * layer["padding"]

    sides = _shrunk(side, encoder)
    painted = sides[-1]
    for layer in decoder:
        painted = grown(painted, layer)
    if painted == side:
        return [0] * len(decoder)
    wanted = sides[::-1]
    return [to - grown(at, layer) for at, to, layer in zip(wanted, wanted[1:], decoder)]


def _relaid(name, value, shape):
    """A tensor of layout 1 as it is in layout 2: there some convolutions lay as matrices."""
    if len(shape) != 4 or value.ndim != 2:
        return value
    first, second, k, _ = shape
    if name.startswith("vae.conv") and value.shape == (k * k * second, first):
        return value.reshape(k, k, second, first).transpose(3, 2, 0, 1)
    if name.startswith("vae.deconv") and value.shape == (first, k * k * second):
        return value.reshape(first, k, k, second).transpose(0, 3, 1, 2)
    return value
