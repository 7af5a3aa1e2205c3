"""Dreams as environments, and learned rewards in place of an environment's."""

import tempfile
import unittest
import warnings
from pathlib import Path

import dropj
import files
import numpy as np

try:
    import gymnasium
    from gymnasium.utils.env_checker import check_env
except ImportError:
    gymnasium = None


@unittest.skipIf(gymnasium is None, "gymnasium is not here")
class Environments(unittest.TestCase):
    def setUp(self):
        warnings.simplefilter("ignore")
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        folder = Path(folder.name)
        self.world = dropj.load_world(files.world(folder / "world.safetensors", longest_episode=6), backend="numpy")
        reward = files.reward(folder / "reward.safetensors")
        self.reward = dropj.load_reward(reward, world=self.world, backend="numpy")

    def test_a_dream_is_an_environment(self):
        for observation in ("picture", "features"):
            check_env(dropj.DreamEnv(self.world, self.reward, observation=observation, render_mode="rgb_array"))
        env = dropj.DreamEnv(self.world, self.reward)
        self.assertEqual(env.observation_space, gymnasium.spaces.Box(0, 255, (12, 16, 3), np.uint8))
        self.assertEqual(env.action_space, gymnasium.spaces.Box(np.float32([0, -2]), np.float32([512, 1])))

    def test_a_dream_is_what_its_seed_and_its_actions_make_of_it(self):
        def driven(env, **how):
            rows = [env.reset(**how)[0]]
            for t in range(6):
                picture, reward, terminated, truncated, info = env.step([90.0 * t, 0.5])
                rows.append(picture)
                self.assertFalse(terminated)
                self.assertEqual(truncated, t == 5)
            return np.stack(rows)

        once = driven(dropj.DreamEnv(self.world, seed=4))
        np.testing.assert_array_equal(once, driven(dropj.DreamEnv(self.world), seed=4))
        env = dropj.DreamEnv(self.world, seed=4)
        np.testing.assert_array_equal(once, driven(env))
        self.assertTrue((driven(env) != once).any(), "the seed is of the first reset alone")
        with self.assertRaises(gymnasium.error.ResetNeeded):
            dropj.DreamEnv(self.world).step([0.0, 0.0])

    def test_the_reward_is_of_the_state_in_which_the_action_is_taken(self):
        env = dropj.DreamEnv(self.world, self.reward, longest=2)
        _, info = env.reset(seed=0, options={"start": 2})
        np.testing.assert_allclose(info["features"], self.world.starts.at(2).features)
        action = np.array([10.0, 0.0], np.float32)
        reward = env.step(action)[1]
        self.assertAlmostEqual(reward, float(self.reward(info["features"], action)), places=6)
        self.assertEqual(dropj.DreamEnv(self.world).reset(seed=0)[1]["features"].shape, (13,))
        free = dropj.DreamEnv(self.world)
        free.reset()
        self.assertEqual(free.step(action)[1], 0.0)

    def test_a_wrapper_pays_the_learned_reward_and_remembers_what_was_driven(self):
        world, reward = self.world, self.reward

        class Overriding(gymnasium.Env):
            """Drives half of what it is asked, and shows pictures that are twice as large."""

            action_space = gymnasium.spaces.Box(np.float32([0, -2]), np.float32([512, 1]))
            observation_space = gymnasium.spaces.Box(0, 255, (24, 32, 3), np.uint8)

            def look(self):
                return self.np_random.integers(0, 256, (12, 16, 3), dtype=np.uint8).repeat(2, 0).repeat(2, 1)

            def reset(self, seed=None, options=None):
                super().reset(seed=seed)
                return self.look(), {}

            def step(self, action):
                return self.look(), 5.0, False, False, {"driven": np.float32(action) / 2}

        check_env(dropj.RewardWrapper(Overriding(), world, reward))
        env = dropj.RewardWrapper(
            Overriding(), world, reward, memory_reset=3, executed=lambda action, info: info["driven"]
        )
        picture, info = env.reset(seed=1)
        memory, t = world.no_memory(), 0
        for action in np.float32([[10, 0], [400, 1], [30, -2], [40, 0.5], [7, 0]]):
            state = dropj.State(world.observe(picture[::2, ::2]), *memory)
            np.testing.assert_allclose(info["features"], state.features, atol=1e-5)
            picture, paid, _, _, info = env.step(action)
            self.assertAlmostEqual(paid, float(reward(state.features, action / 2)), places=5)
            self.assertEqual(info["original_reward"], 5.0)
            t += 1
            memory = world.no_memory() if t % 3 == 0 else world.remember(state, action / 2)

    def test_what_cannot_be_seen_or_driven_is_refused(self):
        with self.assertRaisesRegex(ValueError, "numbers"):
            dropj.RewardWrapper(gymnasium.make("Pendulum-v1"), self.world, self.reward)
        with self.assertRaisesRegex(ValueError, "observation"):
            dropj.DreamEnv(self.world, observation="latents")

        class Blind(gymnasium.Env):
            action_space = gymnasium.spaces.Box(np.float32([0, -2]), np.float32([512, 1]))

            def reset(self, seed=None, options=None):
                return np.zeros(3), {}

            def render(self):
                return None

        with self.assertRaisesRegex(TypeError, "picture"):
            dropj.RewardWrapper(Blind(), self.world, self.reward).reset()
