"""Networks by NumPy and by PyTorch: the same numbers, those of plain loops, and gradients."""

import json
import tempfile
import unittest
import warnings
from pathlib import Path

import dropj
import files
import numpy as np
from dropj import _arrays
from dropj._networks import _NumPy, torch_or_none

TORCH = torch_or_none()


class Networks(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        self.rng = np.random.default_rng(5)

    def world(self, **how):
        return dropj.load_world(files.world(self.folder / "world.safetensors", longest_episode=30), **how)

    def test_convolutions_are_those_of_plain_loops(self):
        m = _NumPy({})
        for stride, padding, k in [(1, 0, 3), (2, 1, 4), (3, 2, 4)]:
            x, bias = self.rng.normal(size=(2, 7, 9, 3)), self.rng.normal(size=5)
            weight = self.rng.normal(size=(5, 3, k, k))
            padded = np.pad(x, [(0, 0), (padding, padding), (padding, padding), (0, 0)])
            rows, columns = ((n + 2 * padding - k) // stride + 1 for n in (7, 9))
            wanted = np.empty((2, rows, columns, 5))
            for i in range(rows):
                for j in range(columns):
                    seen = padded[:, i * stride : i * stride + k, j * stride : j * stride + k]
                    wanted[:, i, j] = np.einsum("bijc,ocij->bo", seen, weight) + bias
            np.testing.assert_allclose(m.conv(x, weight, bias, stride, padding), wanted, rtol=1e-9)

            weight = self.rng.normal(size=(3, 5, k, k))
            rows, columns = ((n - 1) * stride + k for n in (7, 9))
            wanted = np.zeros((2, rows, columns, 5))
            for i in range(7):
                for j in range(9):
                    stamp = np.einsum("bc,coij->bijo", x[:, i, j], weight)
                    wanted[:, i * stride : i * stride + k, j * stride : j * stride + k] += stamp
            for more in [(0, 0), (padding // 2, 0), (0, padding // 2)]:
                last = [side - padding + kept for side, kept in zip((rows, columns), more)]
                kept = wanted[:, padding : last[0], padding : last[1]] + bias
                np.testing.assert_allclose(m.deconv(x, weight, bias, stride, padding, more), kept, atol=1e-5)

    def test_a_world_is_what_its_header_says(self):
        world = self.world()
        self.assertEqual((world.env, world.size, world.n_actions, world.n_features), ("arm", (12, 16), 2, 13))
        self.assertEqual((world.axes.names, world.longest_episode), (["reach", "turn"], 30))
        self.assertEqual((world.axes.low.tolist(), world.axes.high.tolist()), ([0.0, -2.0], [512.0, 1.0]))
        self.assertEqual([part.shape for part in world.starts], [(4, 3), (4, 5), (4, 5)])
        self.assertEqual(world.hash, _arrays.sha256(world.path))

    def test_batches_of_any_shape_are_taken(self):
        world = self.world()
        frames = self.rng.integers(0, 256, (2, 3, 12, 16, 3), dtype=np.uint8)
        z = world.observe(frames)
        self.assertEqual((z.shape, world.decode(z).shape, world.decode(z).dtype), ((2, 3, 3), frames.shape, np.uint8))
        np.testing.assert_allclose(world.observe(frames[1, 2]), z[1, 2], atol=1e-5)
        np.testing.assert_allclose(world.observe(frames / 255), z, atol=1e-5)
        state, action = world.starts.at(0), np.array([100.0, 0.5])
        one = world.imagine(state, action)
        many = world.imagine(world.starts, np.tile(action, (4, 1)))
        np.testing.assert_allclose(one.features, many.features[0], atol=1e-5)
        self.assertEqual(world.state_of(many.features).h.tolist(), many.h.tolist())
        with self.assertRaisesRegex(ValueError, "sees"):
            world.observe(frames[..., :8, :])

    def test_the_mixture_is_sampled_as_it_says(self):
        world = self.world()
        state = dropj.State(*(np.repeat(part[:1], 20_000, 0) for part in world.starts))
        action = np.tile([300.0, -1.0], (20_000, 1))
        drawn = world.imagine(state, action, 1.0, "sample", np.random.default_rng(1))
        log_weights, mean, log_deviation = world.expect(drawn.h[:1])
        weights = np.exp(log_weights[0])
        self.assertTrue(np.allclose(weights.sum(-1), 1, atol=1e-5))
        wanted = (weights * mean[0]).sum(-1)
        variance = (weights * (np.exp(2 * log_deviation[0]) + mean[0] ** 2)).sum(-1) - wanted**2
        np.testing.assert_allclose(drawn.z.mean(0), wanted, atol=0.05)
        np.testing.assert_allclose(drawn.z.var(0), variance, rtol=0.06)
        np.testing.assert_allclose(world.imagine(state.at([0]), action[:1], 1.0).z[0], wanted, atol=1e-5)
        again = world.imagine(state, action, 1.0, "sample", np.random.default_rng(1))
        np.testing.assert_array_equal(again.z, drawn.z)

    def test_a_reward_is_that_of_the_formulas(self):
        path = files.reward(self.folder / "reward.safetensors")
        with warnings.catch_warnings(record=True) as met:
            warnings.simplefilter("always")
            reward = dropj.load_reward(path, world=self.world())
        self.assertIn("learned with the world model sha256:0", str(met[0].message))
        features = self.rng.normal(size=(4, 13)).astype(np.float32)
        actions = np.array([[0.0, -2.0], [512.0, 1.0], [256.0, -0.5], [600.0, 0.0]], np.float32)
        scaled = reward.scaled(actions)
        np.testing.assert_allclose(scaled, [[-1, -1], [1, 1], [0, 0], [1, 1 / 3]], atol=1e-6)
        t = _arrays.read(path)[1]
        for e in range(2):
            x = np.concatenate([features, scaled], 1)
            for i in range(3):
                x = x @ t[f"reward.{i}.weight"][e].T + t[f"reward.{i}.bias"][e]
                x = np.where(x > 0, x, 0.01 * x) if i < 2 else np.tanh(x)
            np.testing.assert_allclose(reward.members(features, actions)[e], x[:, 0], atol=1e-5)
        said = reward(features, actions)
        np.testing.assert_allclose(said, reward.members(features, actions).mean(0), atol=1e-6)
        self.assertEqual(reward(features.reshape(2, 2, 13), actions.reshape(2, 2, 2)).shape, (2, 2))
        self.assertAlmostEqual(float(reward(features[0], actions[0])), float(said[0]), places=5)
        unknown = dropj.load_reward(path)
        with self.assertRaisesRegex(ValueError, "world="):
            unknown(features, actions)
        with self.assertRaisesRegex(ValueError, "numbers"):
            reward(features[:, :12], actions)

    def test_a_reward_of_verdicts_is_that_of_its_rules(self):
        features, actions = self.rng.normal(size=(50, 13)), self.rng.normal(size=(50, 2))
        for rules in ("joint", "apart"):
            path = files.reward(self.folder / f"{rules}.safetensors", key="sparse_reward", outputs=3, rules=rules)
            reward = dropj.load_reward(path)
            chances, worths = reward.chances(features, actions), np.array([-1, 0, 10])
            np.testing.assert_allclose(chances.sum(-1), 1, atol=1e-5)
            np.testing.assert_allclose(reward.members(features, actions), chances @ worths, atol=1e-4)
            if rules == "joint":
                wanted = worths[reward.logits(features, actions).mean(0).argmax(-1)]
            else:
                wanted = (chances @ worths).mean(0)
            np.testing.assert_allclose(reward(features, actions), wanted, atol=1e-4)

    def test_files_of_the_first_layout_hold_the_same_networks(self):
        path = files.reward(self.folder / "reward.safetensors")
        metadata, tensors = _arrays.read(path)
        told = json.loads(metadata["reward"])
        del told["layout"]
        old = {
            name: np.ascontiguousarray(value.transpose(0, 2, 1)) if value.ndim == 3 else value[:, None]
            for name, value in tensors.items()
        }
        files.write(self.folder / "old.safetensors", old, {"reward": json.dumps(told)})
        for name, value in dropj.load_reward(path)._tensors.items():
            np.testing.assert_array_equal(dropj.load_reward(self.folder / "old.safetensors")._tensors[name], value)

        path = files.world(self.folder / "world.safetensors")
        metadata, tensors = _arrays.read(path)
        config = json.loads(metadata["config"])
        del config["layout"]
        old = {
            **tensors,
            "vae.conv1.weight": tensors["vae.conv1.weight"].transpose(2, 3, 1, 0).reshape(4 * 4 * 3, 4),
            "vae.deconv2.weight": tensors["vae.deconv2.weight"].transpose(0, 2, 3, 1).reshape(4, 4 * 4 * 3),
        }
        files.write(self.folder / "old.safetensors", old, {**metadata, "config": json.dumps(config)})
        for name, value in dropj.load_world(path)._tensors.items():
            np.testing.assert_array_equal(dropj.load_world(self.folder / "old.safetensors")._tensors[name], value)

    def test_what_does_not_fit_is_refused_in_words(self):
        metadata, tensors = _arrays.read(files.world(self.folder / "world.safetensors"))
        path = self.folder / "other.safetensors"
        for change, why in [
            ({"vae.fc_mu.weight": np.zeros((3, 5), np.float32)}, "vae.fc_mu.weight"),
            ({"mdn_rnn.lstm.weight_ih": np.zeros((20, 9), np.float32)}, "2 axes"),
            ({"starts.c": np.zeros((4, 6), np.float32)}, "start"),
        ]:
            files.write(path, {**tensors, **change}, metadata)
            with self.assertRaisesRegex(ValueError, why):
                dropj.load_world(path)
        del tensors["vae.dec_fc.bias"]
        files.write(path, tensors, metadata)
        with self.assertRaisesRegex(ValueError, "vae.dec_fc.bias"):
            dropj.load_world(path)
        files.write(path, tensors, {"config": '{"layout": 3}'})
        with self.assertRaisesRegex(ValueError, "layout is 3"):
            dropj.load_world(path)
        with self.assertRaisesRegex(ValueError, "nothing of 'config'"):
            dropj.load_world(files.reward(path))
        with self.assertRaises(FileNotFoundError):
            dropj.load_world(self.folder / "nowhere")
        with self.assertRaisesRegex(ValueError, "backend"):
            self.world(backend="jax")

    @unittest.skipIf(TORCH is None, "PyTorch is not here")
    def test_both_compute_the_same_and_gradients_pass(self):
        one, other = self.world(backend="numpy"), self.world(backend="torch")
        frames = self.rng.integers(0, 256, (3, 12, 16, 3), dtype=np.uint8)
        action = np.array([[3.0, 0.5]] * 4, np.float32)
        for mode, tau in [("mean", 0.1), ("sample", 1.0)]:
            states = [w.imagine(w.starts, action, tau, mode, np.random.default_rng(2)) for w in (one, other)]
            np.testing.assert_allclose(states[0].features, states[1].features, atol=1e-5)
        np.testing.assert_allclose(one.observe(frames), other.observe(frames), atol=1e-4)
        np.testing.assert_allclose(one.intensities(one.starts.z), other.intensities(one.starts.z), atol=1e-5)
        self.assertIsInstance(other.observe(frames), np.ndarray)

        # Tensors are answered in tensors, even by one that computes with NumPy.
        actions = TORCH.tensor(action, requires_grad=True)
        state = dropj.State(*map(TORCH.from_numpy, one.starts))
        path = files.reward(self.folder / "reward.safetensors")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reward = dropj.load_reward(path, world=one, backend="numpy")
        following = one.imagine(state, actions)
        (reward(following.features, actions).sum() + one.intensities(following.z).sum()).backward()
        self.assertTrue(actions.grad.abs().min() > 0)
        np.testing.assert_allclose(following.z.detach().numpy(), one.imagine(one.starts, action).z, atol=1e-5)
