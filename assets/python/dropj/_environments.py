"""Dreams as a gymnasium.Env, and a learned reward in place of an environment's. Needs gymnasium."""

import gymnasium
import numpy as np

from ._world_model import State


class DreamEnv(gymnasium.Env):
    """A world model as an environment: what is done in it is dreamed.

    world        from load_world; its file must hold states to start from
    reward       from load_reward; without one every reward is 0
    seed         of the first reset, where that is not given one
    observation  "picture": what the world model paints, bytes [H, W, 3]; "features": [z | c | h], which rewards read
    temperature  of the mixtures that the next latents are drawn from
    longest      steps of an episode; as many as the world's, or else 1000, where it is not said

    The features of the present state are in info["features"].
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(
        self, world, reward=None, seed=None, *, observation="picture", temperature=1.0, longest=None, render_mode=None
    ):
        if observation not in ("picture", "features"):
            raise ValueError(f'observation is {observation!r}, and must be "picture" or "features"')
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f'render_mode is {render_mode!r}, and must be "rgb_array"')
        if len(world.starts.z) == 0:
            raise ValueError(f"the world model has no states to start dreams from: {world.path}")
        self.world, self.reward, self.observation, self.render_mode = world, reward, observation, render_mode
        self.metadata = {**self.metadata, "render_fps": world.rate}
        self.temperature = temperature
        self.longest = world.longest_episode if longest is None else longest
        self.action_space = _action_space(world)
        if observation == "picture":
            self.observation_space = gymnasium.spaces.Box(0, 255, (*world.size, 3), np.uint8)
        else:
            self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (world.n_features,), np.float32)
        self.state, self.n_steps, self._seed, self._picture = None, 0, seed, None

    def reset(self, *, seed=None, options=None):
        """options may say {"start": number}: which of world.starts the dream begins in."""
        if seed is None and self._seed is not None:
            seed, self._seed = self._seed, None
        super().reset(seed=seed)
        starts = self.world.starts
        drawn = int(self.np_random.integers(len(starts.z)))
        start = (options or {}).get("start", drawn)
        self._stand_in(starts.at(start))
        self.n_steps = 0
        return self._observed(), self._info()

    def step(self, action):
        if self.state is None:
            raise gymnasium.error.ResetNeeded("reset comes before the first step")
        action = np.clip(np.asarray(action, np.float32), self.action_space.low, self.action_space.high)
        reward = 0.0 if self.reward is None else float(self.reward.reward(self.state.features, action))
        self._stand_in(self.world.imagine(self.state, action, self.temperature, "sample", self.np_random))
        self.n_steps += 1
        return self._observed(), reward, False, self.n_steps >= self.longest, self._info()

    def render(self):
        if self.render_mode != "rgb_array" or self.state is None:
            return None
        return self._seen()

    def _stand_in(self, state):
        self.state, self._picture = state, None

    def _seen(self):
        """What the present state looks like, painted once."""
        if self._picture is None:
            self._picture = self.world.decode(self.state.z)
        return self._picture.copy()

    def _observed(self):
        return self._seen() if self.observation == "picture" else self.state.features.copy()

    def _info(self):
        return {"features": self.state.features.copy()}


class RewardWrapper(gymnasium.Wrapper):
    """An environment that pays what a learned reward says, not its own.

    world         the world model, through which the environment is seen and remembered
    reward        from load_reward
    frame         a function of env and observation that tells the picture, bytes [H, W, 3]; where it is not said, the
                  observation if that is one, or else what env.render() gives. Pictures are shrunk to the world model's size
    executed      a function of action and info that tells which action was driven, where the environment overrides actions
    memory_reset  after so many steps the memory is emptied, again and again; as planners do, to whom it comes from the world's
                  file; never where it is not said

    The environment's own reward is in info["original_reward"], what the next one will be read from in info["features"].
    """

    def __init__(self, env, world, reward, *, frame=None, executed=None, memory_reset=None):
        super().__init__(env)
        if env.action_space.shape != (world.n_actions,):
            raise ValueError(f"an action of the world model has {world.n_actions} numbers, and this is {env.action_space}")
        if memory_reset is not None and memory_reset < 1:
            raise ValueError(f"memory_reset is {memory_reset}, and must be 1 or more")
        self.world, self.learned, self.frame, self.executed = world, reward, frame, executed
        self.memory_reset = memory_reset
        self.state, self.n_steps = None, 0

    def reset(self, **kwargs):
        observation, info = self.env.reset(**kwargs)
        self.n_steps = 0
        self.state = State(self._observed(observation), *self.world.no_memory())
        return observation, {**info, "features": self.state.features}

    def step(self, action):
        observation, original, terminated, truncated, info = self.env.step(action)
        driven = np.asarray(action if self.executed is None else self.executed(action, info), np.float32)
        reward = float(self.learned.reward(self.state.features, driven))
        self.n_steps += 1
        if self.memory_reset is not None and self.n_steps % self.memory_reset == 0:
            memory = self.world.no_memory()
        else:
            memory = self.world.remember(self.state, driven)
        self.state = State(self._observed(observation), *memory)
        info = {**info, "original_reward": original, "features": self.state.features}
        return observation, reward, terminated, truncated, info

    def _observed(self, observation):
        """The latents of what is seen."""
        if self.frame is not None:
            picture = self.frame(self.env, observation)
        elif getattr(observation, "dtype", None) == np.uint8 and np.ndim(observation) == 3:
            picture = observation
        else:
            picture = self.env.render()
        picture = np.asarray(picture)
        if picture.ndim != 3 or picture.dtype != np.uint8 or picture.shape[2] < 3:
            raise TypeError(
                "there is no picture, bytes [height, width, 3], in the observation or from render: say by frame where it is"
            )
        return self.world.observe(_shrunk(picture[:, :, :3], self.world.size))


def _action_space(world):
    if world.axes is None:
        raise ValueError(f"the world model's file does not tell the ranges of actions: {world.path}")
    return gymnasium.spaces.Box(world.axes.low, world.axes.high, dtype=np.float32)


def _shrunk(picture, size):
    """Each pixel the mean of the area that it covers."""
    if picture.shape[:2] == tuple(size):
        return picture
    small = picture.astype(np.float32)
    for axis, to in enumerate(size):
        n = picture.shape[axis]
        edges = np.arange(to + 1) * (n / to)
        pixels = np.arange(n)
        shared = np.minimum(edges[1:, None], pixels + 1) - np.maximum(edges[:-1, None], pixels)
        weights = (np.clip(shared, 0, None) * (to / n)).astype(np.float32)
        small = np.moveaxis(np.tensordot(weights, small, (1, axis)), 0, axis)
    return (small + 0.5).astype(np.uint8)
