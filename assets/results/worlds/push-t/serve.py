"""PushT-v0 of gym_pusht as a world of dropj. An action is a place to go to, from 0 to 512: it has no neutral one."""

import dropj  # first: what is printed from here on goes to standard error

import gym_pusht  # noqa: F401: it registers the world
import gymnasium
import numpy as np


class Policy:
    """Goes to one place after the other: half of them anywhere, half of them through the block."""

    def reset(self, env, rng):
        self.rng, self.left = rng, 0

    def act(self, env):
        world = env.unwrapped
        at, block = np.asarray(world.agent.position), np.asarray(world.block.position)
        if self.left == 0:
            self.draw(block, at)
        self.left -= 1
        way = self.to - at
        return np.clip(at + way * min(1, 60 / max(np.hypot(*way), 1e-9)), 0, 512)  # no further ahead than a hand would point

    def draw(self, block, at):
        rng = self.rng
        self.left, self.to = rng.integers(5, 21), rng.uniform(50, 462, 2)
        if rng.random() < 0.5:
            through = block + rng.normal(0, 30, 2) - at
            self.to = at + through * (1 + 80 / max(np.hypot(*through), 1e-9))


if __name__ == "__main__":
    dropj.serve(
        lambda: gymnasium.make("gym_pusht/PushT-v0", obs_type="pixels", render_mode="rgb_array"),
        name="PushT-v0",
        axes=["x", "y"],
        neutral=[256, 256],
        hertz=10,
        size=(96, 96),
        pixels="observation",
        policy=Policy,
    )
