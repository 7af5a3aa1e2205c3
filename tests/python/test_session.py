"""Sessions: folded as the page on formats says, and labeled by any weights."""

import json
import tempfile
import unittest
from pathlib import Path

import dropj
import files
import numpy as np
from dropj import _arrays

WEIGHTS = {"safety": 1.0, "default": 0.75, "justifications": [["grass", 1.0], ["ice", 0.9], ["default", 0.6]]}


class Sessions(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name) / "s"
        self.folder.mkdir()
        self.lines = []

    def happened(self, event, **fields):
        self.lines.append({"event": event, **fields, "seq": len(self.lines), "at": 1000 + len(self.lines)})

    def answered(self, query, response, **fields):
        how = {"secs": 2.5, "loops": 1, "annotator": "anna", "sides_swapped": False, **fields}
        self.happened("answered", query=query, response=response, **how)

    def asked(self, query, left, right, choice="uniform"):
        clips = {side: {"dream": clip[0], "start": clip[1]} for side, clip in [("left", left), ("right", right)]}
        self.happened("asked", query=query, **clips, choice=choice)

    def kept(self, dream, n_steps, **fields):
        how = {"seed": 7, "marks": [], "source": "user", "file": f"dreams/{dream:04}.safetensors", "sha256": "sha256:0"}
        self.happened("dream_kept", dream=dream, len=n_steps, **{**how, **fields})

    def session(self, protocol="dropj", world_model="sha256:0", tail="", **how):
        header = {
            "format": 3,
            "app": "0.1.0",
            "env": "arm",
            "protocol": protocol,
            "seed": 3,
            "world_model": world_model,
            "created_at": 0,
            "config": {"weights": WEIGHTS, "annotator": "anna"},
        }
        (self.folder / "session.json").write_text("\ufeff" + json.dumps(header))
        log = "".join(json.dumps(line) + "\n" for line in self.lines)
        (self.folder / "events.jsonl").write_text(log + tail)
        return dropj.read_session(self.folder, **how)

    def test_labels_are_those_of_the_paper_by_any_weights(self):
        self.kept(0, 60)
        said = [
            {"safety": "only_left"},
            {"safety": "only_right"},
            {"safety": "neither"},
            {"safety": {"both": "left"}},
            {"safety": {"both": "right"}},
            {"safety": {"both": "equal"}},
            {"preferred": "left"},
            {"preferred": "equal"},
            {"justified": [0, "right"]},
            {"justified": [1, "left"]},
            {"justified": [2, "right"]},
            {"justified": [[1, 0], "left"]},
            {"skipped": None},
            {"skipped": "ambiguous"},
        ]
        for number, response in enumerate(said):
            self.asked(number, (0, number), (0, 40))
            self.answered(number, response)
        session = self.session()
        mus = [mu for _, mu in session.labels()]
        np.testing.assert_allclose(mus, [1, 0, 0.5, 0.75, 0.25, 0.5, 1, 0.5, 0, 0.9, 0.4, 1], atol=1e-6)
        weights = session.weights_with(0.9, 0.8, {"grass": 0.95, "ice": 0.7, "default": 1.0})
        mus = [mu for _, mu in session.labels(weights)]
        np.testing.assert_allclose(mus, [0.9, 0.1, 0.5, 0.8, 0.2, 0.5, 1, 0.5, 0.05, 0.7, 0, 0.95], atol=1e-6)
        self.assertEqual(session.weights, WEIGHTS, "nothing is changed by asking")
        self.assertEqual(session.justification(session.answers[9]), "ice")
        self.assertEqual(session.justification(session.answers[11]), "grass", "the most severe is named")
        self.assertEqual(session.active(session.answers[11]), ["grass", "ice"])
        self.assertIsNone(session.active(session.answers[0]))
        for wrong in [
            {"safety": 0.5},
            {"default": 1.1},
            {"justifications": {"grass": 1}},
            {"justifications": {"grass": 0.7, "ice": 0.4, "default": 1}},
        ]:
            with self.assertRaises(ValueError, msg=wrong):
                session.weights_with(**wrong)

    def test_the_last_answer_counts_and_what_was_taken_back_does_not(self):
        self.kept(0, 60)
        for number in range(3):
            self.asked(number, (0, 0), (0, 40))
            self.answered(number, {"preferred": "left"})
        self.answered(0, {"preferred": "right"})
        self.happened("retracted", query=1)
        self.happened("retracted", query=0)
        self.happened("restored", query=0)
        self.asked(3, (0, 40), (0, 0), {"again": 2})
        self.answered(3, {"preferred": "right"})
        self.asked(4, (0, 1), (0, 2))
        self.answered(4, {"skipped": None}, left_unsafe_from=9)
        self.happened("skip_explained", query=4, reason="hallucinated")
        self.happened("flagged", query=2)
        session = self.session("drope")
        self.assertEqual(session.labels(), [(2, 1.0), (0, 0.0)])
        self.assertEqual([answer.query for answer in session.answers], [2, 0, 3, 4])
        self.assertTrue(session.queries[2].is_flagged)
        row = session.rows()[-1]
        self.assertEqual((row["skipped"], row["left_unsafe_from"], row["mu"]), ("hallucinated", 9, None))
        self.assertEqual((session.rows()[2]["choice"], session.rows()[2]["mu"]), ("again 2", None))

    def test_verdicts_are_told_with_their_worth(self):
        self.kept(0, 60, source="synthesized", acquisition="novelty")
        self.happened("protocol_changed", protocol="dros")
        for number, verdict in enumerate(["unsafe", "good"]):
            transition = {"dream": 0, "first": 5, "step": 6 + number}
            self.happened("asked_transition", query=number, transition=transition, choice={"synthesized": "novelty"})
            self.answered(number, {"judged": verdict})
        session = self.session()
        self.assertEqual([(one.transition.step, one.worth) for one in session.verdicts()], [(6, -1.0), (7, 10.0)])
        self.assertEqual(session.labels(), [])
        row = session.rows()[1]
        self.assertEqual((row["protocol"], row["verdict"], row["step"]), ("DROS", "good", 7))
        self.assertEqual((row["choice"], row["left_start"]), ("synthesized: novelty", 0))

    def test_a_line_that_was_cut_short_has_not_happened(self):
        self.kept(0, 60)
        self.assertEqual(len(self.session(tail='\r\n{"event":"fla').dreams), 1)
        with self.assertRaisesRegex(ValueError, "line 2 is not JSON"):
            self.session(tail='{"event":"fla\n{}')
        with self.assertRaisesRegex(ValueError, "not event 1"):
            self.session(tail='{"event":"flagged","query":0,"seq":4,"at":0}')

    def test_what_cannot_have_happened_is_refused_by_its_line(self):
        self.kept(0, 60)
        self.asked(0, (0, 0), (0, 40))
        for event, fields in [
            ("asked", {"query": 0, "left": {"dream": 0, "start": 0}, "right": {"dream": 0, "start": 0}, "choice": "uniform"}),
            ("asked", {"query": 1, "left": {"dream": 0, "start": 41}, "right": {"dream": 0, "start": 0}, "choice": "uniform"}),
            ("asked", {"query": 1, "left": {"dream": 7, "start": 0}, "right": {"dream": 0, "start": 0}, "choice": "uniform"}),
            ("answered", {"query": 1, "response": {"preferred": "left"}}),
            ("answered", {"query": -1, "response": {"preferred": "left"}}),
            ("answered", {"query": 0, "response": {"preferred": "both"}, "secs": 1, "loops": 0}),
            ("answered", {"query": 0, "response": {"judged": "fine"}, "secs": 1, "loops": 0}),
            ("retracted", {"query": 0}),
            ("restored", {"query": 0}),
            ("skip_explained", {"query": 0, "reason": "other"}),
            ("painted", {}),
        ]:
            self.happened(event, **fields)
            with self.assertRaisesRegex(ValueError, "line 3 cannot have happened", msg=(event, fields)):
                self.session()
            self.lines.pop()
        self.assertEqual(len(self.session().queries), 1)

    def dream(self, world, number, n_steps):
        """A dream that follows the mean of the world's mixtures."""
        rng = np.random.default_rng(number)
        start = world.starts.at(number)
        actions = rng.uniform(world.axes.low, world.axes.high, (n_steps, 2)).astype(np.float32)
        state, zs = start, []
        for action in actions:
            zs.append(state.z)
            state = world.imagine(state, action)
        path = self.folder / f"dreams/{number:04}.safetensors"
        path.parent.mkdir(exist_ok=True)
        arrays = {"start.z": start.z, "start.c": start.c, "start.h": start.h, "zs": np.stack(zs), "actions": actions}
        files.write(path, {**arrays, "unsafe_marks": np.zeros(0, np.uint32)}, {"seed": "7"})
        self.kept(number, n_steps, sha256=_arrays.sha256(path))
        return state

    def test_pairs_are_fragments_as_imitation_takes_them(self):
        world = dropj.load_world(files.world(self.folder / "world_model.safetensors"), backend="numpy")
        after = [self.dream(world, number, 40) for number in (0, 1)]
        self.asked(0, (0, 3), (1, 20))
        self.answered(0, {"safety": "only_right"})
        session = self.session(world_model=world.hash, backend="numpy")
        pairs = session.pairs()
        self.assertEqual((pairs.preferences.dtype, pairs.preferences.tolist(), pairs.queries), (np.float32, [0.0], [0]))
        left, right = pairs.fragments[0]
        self.assertEqual((left.obs.shape, left.acts.shape, left.infos, left.terminal), ((21, 13), (20, 2), None, False))
        np.testing.assert_array_equal(left.obs, session.features(0)[3:24])
        np.testing.assert_allclose(right.obs[-1], after[1].features, atol=1e-5)
        np.testing.assert_array_equal(right.acts, session.dreams[1].actions[20:])
        segment = session.segment(session.queries[0].left)
        np.testing.assert_array_equal(segment.features, left.obs[:20])
        self.assertEqual(session.frames(segment.clip).shape, (20, 12, 16, 3))
        np.testing.assert_array_equal(session.pairs(observation="latents").fragments[0][0].obs, left.obs[:, :3])
        picture = session.pairs(observation="picture").fragments[0][1].obs
        self.assertEqual((picture.shape, picture.dtype), ((21, 12, 16, 3), np.uint8))
        np.testing.assert_array_equal(picture[:20], session.frames(session.queries[0].right))

    def test_files_that_are_others_are_refused(self):
        world = dropj.load_world(files.world(self.folder / "world_model.safetensors"), backend="numpy")
        self.dream(world, 0, 40)
        self.kept(1, 40, file="../outside.safetensors")
        with self.assertRaisesRegex(FileNotFoundError, "world="):
            self.session().features(0)
        session = self.session(world=world)
        with self.assertWarnsRegex(UserWarning, "stored anew"):
            self.assertEqual(session.features(0).shape, (40, 13))
        with self.assertRaisesRegex(ValueError, "folder"):
            session.features(1)
        path = self.folder / "dreams/0000.safetensors"
        path.write_bytes(path.read_bytes()[:-4] + b"\0\0\0\1")
        with self.assertRaisesRegex(ValueError, "not the one"):
            self.session(world_model=world.hash).features(0)
