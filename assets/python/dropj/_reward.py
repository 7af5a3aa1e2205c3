"""A reward that dropj learned: of preferences, or of verdicts. Needs NumPy; PyTorch makes it quick."""

import os
import warnings

import numpy as np

from . import _arrays
from ._axes import axes_of, world_of
from ._networks import Network

# What verdicts are worth, in the order of their classes: unsafe, neutral, good.
_WORTHS = np.array([-1, 0, 10], np.float32)
# What is taken from what a network says of a hazard before the sigmoid.
_HAZARD_PRIOR = 4


def load_reward(path, *, world=None, backend=None, device=None):
    """The reward in a file: a Reward of preferences, or a SparseReward of verdicts.

    world is the world model whose features it reads: what it was learned with is held against that, and the ranges of actions
    come from it where the reward's own file does not tell them.
    """
    metadata, tensors = _arrays.read(path)
    kind = SparseReward if "sparse_reward" in metadata else Reward
    return kind(path, metadata, tensors, world, backend, device)


class _Ensemble(Network):
    """Networks that read [features | action].

    config       how they are made and were fitted
    n_features   how many features of a state they read
    n_members    how many networks there are
    n_hazards    how many hazards are told beside, 0 in most
    axes         names, low and high of an action's numbers
    world_model  the hash of the world model whose features they read
    """

    def __init__(self, path, metadata, tensors, world, backend, device):
        self.path = os.fspath(path)
        try:
            header, layout = _arrays.described(metadata, self._key)
            self.config, self.n_features, self.world_model = (
                header[name] for name in ("config", "n_features", "world_model")
            )
            self.n_members = self.config["members"]
            self.n_hazards = self.config.get("hazards", 0)
            parameters = self._understood(layout, tensors)
            self.n_actions = parameters["0.weight"].shape[2] - self.n_features
            self.axes = axes_of(world_of(metadata, header), self.n_actions)
        except (KeyError, TypeError, ValueError, IndexError) as error:
            what = f"no {error}" if isinstance(error, KeyError) else error
            raise ValueError(f"this is not a reward as it should be ({what}): {path}") from None
        super().__init__(parameters, backend, device)
        if world is not None:
            self._require(world)

    def _require(self, world):
        """Whether this reads the features of that world model, as far as shapes tell."""
        if (world.n_features, world.n_actions) != (self.n_features, self.n_actions):
            raise ValueError(
                f"the reward reads {self.n_features} features and {self.n_actions} numbers of an action, and the world model "
                f"has {world.n_features} and {world.n_actions}: {self.path}"
            )
        if world.hash != self.world_model:
            warnings.warn(
                f"the reward was learned with the world model {self.world_model}, and this is {world.hash}: another one, or the "
                f"same stored anew: {self.path}",
                stacklevel=5,
            )
        if world.axes is not None:
            self.axes = world.axes

    def _understood(self, layout, tensors):
        """Weights [E, out, in] and biases [E, out] of each layer, and the same of what tells hazards."""
        parameters, n_in = self._layers(layout, tensors, self._key, self.n_members, self._n_outputs)
        if self.n_hazards:
            hazards, n_read = self._layers(layout, tensors, "hazards", 1, self.n_hazards)
            cost = tensors["hazards.cost"]
            if n_read != n_in or cost.shape != (self.n_hazards,):
                raise ValueError(f"what tells hazards reads {n_read} numbers, the rest {n_in}, and costs have the shape {cost.shape}")
            parameters |= {f"hazards.{name}": value for name, value in hazards.items()} | {"hazards.cost": cost}
        return parameters

    def _layers(self, layout, tensors, key, n_members, n_outputs):
        """The layers of networks that are stored under this key, and how many numbers they read."""
        n_layers, hidden = self.config["layers"], self.config["hidden"]
        parameters, n_in = {}, None
        for i in range(n_layers + 1):
            weight, bias = (tensors[f"{key}.{i}.{part}"] for part in ("weight", "bias"))
            if layout == 1:
                weight, bias = weight.transpose(0, 2, 1), bias[:, 0]
            n_out = n_outputs if i == n_layers else hidden
            n_in = weight.shape[2] if n_in is None else n_in
            if weight.shape != (n_members, n_out, n_in) or bias.shape != (n_members, n_out):
                raise ValueError(f"layer {i} has the shapes {weight.shape} and {bias.shape}")
            parameters[f"{i}.weight"] = np.ascontiguousarray(weight)
            parameters[f"{i}.bias"] = np.ascontiguousarray(bias)
            n_in = n_out
        return parameters, parameters["0.weight"].shape[2]

    def _through(self, m, x, activation, key="", n_members=None):
        """What each member makes of rows [..., F + A]: [E, N, outputs]."""
        x = m.stacked(x.reshape((-1, x.shape[-1])), n_members or self.n_members)
        n = self.config["layers"] + 1
        for i in range(n):
            x = m.members(x, m.t[f"{key}{i}.weight"], m.t[f"{key}{i}.bias"])
            x = activation(x) if i + 1 < n else x
        return x

    def _rows(self, m, features, actions):
        rows = m.concatenate([m.taken(features), actions])
        if rows.shape[-1] != self.n_features + self.n_actions:
            raise ValueError(f"features and actions have {rows.shape[-1]} numbers, not {self.n_features} + {self.n_actions}")
        return rows

    def __call__(self, features, actions):
        return self.reward(features, actions)


class Reward(_Ensemble):
    """The mean of networks that learned preferences, each of which says a number from -1 to 1, less what hazards cost.

    Where answers named justifications, one more network tells how likely a step shows each hazard, from 0 to 1.
    """

    _key, _n_outputs = "reward", 1

    def scaled(self, actions):
        """Actions as driven, each number moved to [-1, 1] by the range of its axis."""
        with self._computing(actions) as m:
            return m.out(self._scaled(m, m.taken(actions)))

    def _scaled(self, m, actions):
        if self.axes is None:
            raise ValueError("the reward's file does not tell the ranges of actions: load it with world=...")
        low, high = m.taken(self.axes.low), m.taken(self.axes.high)
        return m.clip(2 * (actions - low) / (high - low) - 1, -1, 1)

    def members(self, features, actions):
        """What each network says of states with these features [..., F] and actions as driven [..., A]: [E, ...]."""
        with self._computing(features, actions) as m:
            return m.out(self._said(m, features, actions))

    def reward(self, features, actions):
        """The reward of states with these features [..., F] and actions as driven [..., A]: [...]."""
        with self._computing(features, actions) as m:
            return m.out(self._said(m, features, actions).mean(0))

    def hazards(self, features, actions):
        """How likely states with these features [..., F] and actions as driven [..., A] show each hazard: [..., J]."""
        with self._computing(features, actions) as m:
            return m.out(self._shown(m, self._rows(m, features, self._scaled(m, m.taken(actions)))))

    def _said(self, m, features, actions):
        x = self._rows(m, features, self._scaled(m, m.taken(actions)))
        y = m.tanh(self._through(m, x, m.leaky_relu)).reshape((self.n_members, *x.shape[:-1]))
        if not self.n_hazards:
            return y
        return y - (self._shown(m, x) * m.t["hazards.cost"]).sum(-1)

    def _shown(self, m, x):
        told = self._through(m, x, m.leaky_relu, "hazards.", 1)
        return m.sigmoid(told - _HAZARD_PRIOR).reshape((*x.shape[:-1], self.n_hazards))


class SparseReward(_Ensemble):
    """Networks that learned verdicts: whether a transition is unsafe, neutral or good, worth -1, 0 and 10."""

    _key, _n_outputs = "sparse_reward", 3

    def logits(self, features, actions):
        """What each network thinks of each verdict, before the softmax: [E, ..., 3]."""
        with self._computing(features, actions) as m:
            return m.out(self._logits(m, features, actions))

    def chances(self, features, actions):
        """How likely each network finds each verdict: [E, ..., 3]."""
        with self._computing(features, actions) as m:
            return m.out(m.softmax(self._logits(m, features, actions)))

    def members(self, features, actions):
        """What each network expects: [E, ...]."""
        with self._computing(features, actions) as m:
            return m.out((m.softmax(self._logits(m, features, actions)) * m.taken(_WORTHS)).sum(-1))

    def reward(self, features, actions):
        """The reward of states with these features [..., F] and actions as driven [..., A]: [...].

        By the rules "joint" it is the worth of the verdict that is likeliest to all networks together, by "apart" the mean of
        what each expects.
        """
        with self._computing(features, actions) as m:
            logits = self._logits(m, features, actions)
            if self.config["rules"] == "apart":
                return m.out((m.softmax(logits) * m.taken(_WORTHS)).sum(-1).mean(0))
            return m.out((m.one_hot(logits.mean(0).argmax(-1), 3) * m.taken(_WORTHS)).sum(-1))

    def _logits(self, m, features, actions):
        x = self._rows(m, features, m.taken(actions))
        return self._through(m, x, m.relu).reshape((self.n_members, *x.shape[:-1], 3))
