"""SafetyPointGoal1-v0 of Safety-Gymnasium as a world of dropj: true costs, 64 x 64 pixels, 50 steps a second."""

import dropj  # first: what is printed from here on goes to standard error

import dataclasses

# From Python 3.11 on, dataclasses refuse the arrays that Safety-Gymnasium has as defaults.
plain = dataclasses._get_field


def lenient(cls, name, kind, kw_only):
    value = getattr(cls, name, dataclasses.MISSING)
    if type(value).__hash__ is None and not isinstance(value, dataclasses.Field):
        setattr(cls, name, dataclasses.field(default_factory=lambda: value))
    return plain(cls, name, kind, kw_only)


dataclasses._get_field = lenient

import gymnasium
import numpy as np
import safety_gymnasium


class World(gymnasium.Wrapper):
    def step(self, action):
        *rest, info = self.env.step(action)
        speed = float(np.linalg.norm(self.unwrapped.task.agent.vel[:2]))
        return *rest, {"goal_met": False, **info, "speed": speed}


def world():
    env = safety_gymnasium.make("SafetyPointGoal1-v0")
    env.unwrapped.task.render_conf.lidar_markers = False
    return World(env)


def picture(env, _):
    """The middle of the camera that follows. The world's own render paints the cost into the picture."""
    whole = env.unwrapped.task.render(width=128, height=128, mode="rgb_array", camera_name="track", cost={})
    return whole[32:96, 32:96]


class Policy:
    """Moves in stretches of half a second to two, each towards the goal, a hazard or a point."""

    def reset(self, env, rng):
        self.rng, self.left = rng, 0

    def act(self, env):
        task, rng = env.unwrapped.task, self.rng
        if self.left == 0:
            self.draw(task)
        self.left -= 1
        to = task.goal.pos if self.to is None else self.to
        forward, sideways = (task.agent.mat.T @ (np.asarray(to) - task.agent.pos))[:2]
        bearing = np.arctan2(sideways, forward)
        if self.backwards:
            bearing = (bearing + 2 * np.pi) % (2 * np.pi) - np.pi
        drive = self.speed * np.cos(bearing) * (-1 if self.backwards else 1)
        return np.clip([drive, 2 * bearing + rng.normal(0, 0.3)], -1, 1)

    def draw(self, task):
        rng = self.rng
        self.left, self.speed, self.backwards = rng.integers(20, 81), rng.uniform(0.2, 1), rng.random() < 0.07
        kind = rng.random()
        if kind < 0.5:
            self.to = None  # the goal, which may move
        elif kind < 0.8:
            self.to = task.hazards.pos[rng.integers(len(task.hazards.pos))]
        else:
            self.to = [*rng.uniform(-1.5, 1.5, 2), 0]


if __name__ == "__main__":
    dropj.serve(
        world,
        name="SafetyPointGoal1-v0",
        axes=["drive", "turn"],
        neutral=[0, 0],
        hertz=50,
        size=(64, 64),
        pixels=picture,
        safety=["cost_hazards"],
        progress=["goal_met"],
        policy=Policy,
    )
