"""A session of dropj: its dreams, what was asked, what was answered, and what answers mean. Needs NumPy."""

import json
import os
import warnings
from pathlib import Path, PurePath
from typing import NamedTuple, Optional

import numpy as np

from . import _arrays
from ._world_model import State, WorldModel, load_world

SEGMENT_LEN = 20
_FORMATS = (1, 2, 3)
_NAMES = {
    "drop": "DROP",
    "drope": "DROPe",
    "dropj": "DROPJ",
    "dropj-multi": "DROPJ (multiple)",
    "request": "ReQueST",
    "dros": "DROS",
}
_WORTHS = {"unsafe": -1.0, "neutral": 0.0, "good": 10.0}
# No world model is larger, and in a folder of more files none is looked at that is not named.
_MOST_BYTES = 1 << 30
_MANY = 200


class Clip(NamedTuple):
    """20 steps of a dream."""

    dream: int
    start: int


class Transition(NamedTuple):
    """A step of a dream, labeled within the trajectory that begins at first."""

    dream: int
    first: int
    step: int


class Segment(NamedTuple):
    """A clip as numbers: a row a step."""

    clip: Clip
    features: np.ndarray  # [20, Z + 2 M]
    actions: np.ndarray  # [20, A], as driven


class Fragment(NamedTuple):
    """A clip as HumanCompatibleAI/imitation has trajectories: imitation.data.types.Trajectory(**fragment._asdict())."""

    obs: np.ndarray  # [21, ...]
    acts: np.ndarray  # [20, A]
    infos: None
    terminal: bool


class Pairs(NamedTuple):
    """Labeled pairs. preferences[i] is how likely the first of fragments[i] is the better one, as float32."""

    fragments: list
    preferences: np.ndarray
    queries: list


class Judged(NamedTuple):
    """A verdict on a transition, and what it is worth."""

    query: int
    transition: Transition
    verdict: str
    worth: float


class Answer(NamedTuple):
    """What was said to a query, of its own left and right."""

    query: int
    response: dict
    secs: float
    loops: int
    annotator: str
    sides_swapped: bool
    left_unsafe_from: Optional[int]
    right_unsafe_from: Optional[int]
    protocol: str
    seq: int
    at: int


class Query:
    """What was asked, and what became of it."""

    def __init__(self, number, left, right, transition, choice):
        self.number, self.left, self.right, self.transition, self.choice = number, left, right, transition, choice
        self.is_flagged = False
        self._given, self._retracted = [], []

    @property
    def answer(self):
        """The Answer that counts, or None."""
        return self._given[-1] if self._given else None

    @property
    def repeats(self):
        """The query that this one asks again, or None."""
        return self.choice.get("again") if isinstance(self.choice, dict) else None

    def __repr__(self):
        return f"Query({self.number}, {self.left}, {self.right}, {self.answer and self.answer.response})"


class Dream:
    """A dream: number, n_steps, seed, marks, source, acquisition, planned and is_dropped, and its arrays."""

    def __init__(self, folder, event):
        self.number, self.n_steps, self.seed = event["dream"], event["len"], event["seed"]
        self.marks, self.source = event["marks"], event["source"]
        self.acquisition, self.planned = event.get("acquisition"), event.get("planned", 0)
        self.file, self.sha256, self.is_dropped = event["file"], event["sha256"], False
        self._folder, self._arrays = folder, None

    @property
    def start(self):
        """The State that it begins in."""
        return State(*(self._read("start." + part) for part in "zch"))

    @property
    def zs(self):
        """The latents of every step: [T, Z]."""
        return self._read("zs")

    @property
    def actions(self):
        """What was driven in every step: [T, A]."""
        return self._read("actions")

    def _read(self, name):
        if self._arrays is None:
            path = _inside(self._folder, self.file)
            if _arrays.sha256(path) != self.sha256:
                raise ValueError(f"the file of this dream is not the one that was kept: {path}")
            _, arrays = _arrays.read(path)
            missing = [n for n in ("start.z", "start.c", "start.h", "zs", "actions") if n not in arrays]
            if missing or len(arrays["zs"]) != self.n_steps or len(arrays["actions"]) != self.n_steps:
                raise ValueError(f"this is not a dream of {self.n_steps} steps: {path}")
            self._arrays = arrays
        return self._arrays[name]

    def __repr__(self):
        return f"Dream({self.number}, {self.n_steps} steps)"


def read_session(folder, *, world=None, backend=None):
    """The session in a folder. It is only read.

    world is its world model, or the path of that; where it is not given, it is looked for by its hash once it is needed.
    """
    return Session(folder, world=world, backend=backend)


class Session:
    """A session, as folding its log gives it.

    header    session.json
    protocol  which questions are asked now
    weights   how much answers weigh now: {"safety": w, "default": w, "justifications": [[name, w], ...]}
    dreams, queries   in the order of their numbers
    fits      the events of rewards that were learned, the last one last
    """

    def __init__(self, folder, *, world=None, backend=None):
        self.folder = Path(folder)
        self.header = _header(self.folder / "session.json")
        self.protocol, self.weights = self.header["protocol"], self.header["config"]["weights"]
        self.dreams, self.queries, self.fits, self.held_back = [], [], [], 0
        self._world, self._backend, self._is_checked, self._features = world, backend, False, {}
        path = self.folder / "events.jsonl"
        for line, entry in _entries(path):
            try:
                self._apply(entry)
            except (KeyError, IndexError, TypeError, ValueError) as error:
                raise ValueError(f"line {line} cannot have happened ({error!r}): {path}") from None

    def _apply(self, entry):
        event = entry["event"]
        if event == "dream_kept":
            _next(entry["dream"], self.dreams)
            self.dreams.append(Dream(self.folder, entry))
        elif event in ("dream_dropped", "dream_restored"):
            self._of(self.dreams, entry["dream"]).is_dropped = event == "dream_dropped"
        elif event == "asked":
            _next(entry["query"], self.queries)
            left, right = (Clip(entry[side]["dream"], entry[side]["start"]) for side in ("left", "right"))
            for clip in (left, right):
                if not 0 <= clip.start <= self._of(self.dreams, clip.dream).n_steps - SEGMENT_LEN:
                    raise ValueError(f"there is no {clip}")
            self.queries.append(Query(entry["query"], left, right, None, entry["choice"]))
        elif event == "asked_transition":
            _next(entry["query"], self.queries)
            told = entry["transition"]
            transition = Transition(told["dream"], told["first"], told["step"])
            n_steps = self._of(self.dreams, transition.dream).n_steps
            if not 0 <= transition.first <= transition.step < n_steps - 1 or n_steps < SEGMENT_LEN:
                raise ValueError(f"there is no {transition}")
            # The clip that shows it, with what comes before and after.
            start = min(max(transition.step + 1 - 14, 0), n_steps - SEGMENT_LEN)
            clip = Clip(transition.dream, start)
            self.queries.append(Query(entry["query"], clip, clip, transition, entry["choice"]))
        elif event == "answered":
            query = self._of(self.queries, entry["query"])
            self._mu(entry["response"], self.weights)  # it can be understood
            query._retracted.clear()
            query._given.append(
                Answer(
                    entry["query"],
                    entry["response"],
                    entry["secs"],
                    entry["loops"],
                    entry["annotator"],
                    entry["sides_swapped"],
                    entry.get("left_unsafe_from"),
                    entry.get("right_unsafe_from"),
                    self.protocol,
                    entry["seq"],
                    entry["at"],
                )
            )
        elif event == "skip_explained":
            given = self._of(self.queries, entry["query"])._given
            given[-1] = given[-1]._replace(response={"skipped": entry["reason"]})
        elif event == "retracted":
            query = self._of(self.queries, entry["query"])
            query._retracted.append(query._given.pop())
        elif event == "restored":
            query = self._of(self.queries, entry["query"])
            query._given.append(query._retracted.pop())
        elif event in ("flagged", "unflagged"):
            self._of(self.queries, entry["query"]).is_flagged = event == "flagged"
        elif event == "protocol_changed":
            self.protocol = entry["protocol"]
        elif event == "weights_changed":
            self.weights = entry["weights"]
        elif event == "screen_changed":
            self.held_back = entry["held_back"]
        elif event == "fitted":
            self.fits.append(entry)
        else:
            raise ValueError(f"there is no event {event!r}")

    @staticmethod
    def _of(numbered, number):
        if not isinstance(number, int) or not 0 <= number < len(numbered):
            raise ValueError(f"there is no number {number!r}")
        return numbered[number]

    # What was said.

    @property
    def answers(self):
        """The answers that count, skips among them, in the order of answering."""
        return sorted((query.answer for query in self.queries if query.answer), key=lambda answer: answer.seq)

    def weights_with(self, safety=None, default=None, justifications=None):
        """The present weights but for these. justifications are {name: weight}, of all names of the session."""
        weights = dict(self.weights)
        for name, weight in [("safety", safety), ("default", default)]:
            if weight is not None:
                weights[name] = _weight(name, weight)
        if justifications is not None:
            names = [name for name, _ in self.weights["justifications"]]
            if sorted(justifications) != sorted(names):
                raise ValueError(f"the answers of this session name {names}: give each its weight")
            named = [[name, _weight(name, justifications[name])] for name in names]
            weights["justifications"] = named
        return weights

    def mu(self, query, weights=None):
        """How likely the left clip of a query is the better one, as its answer says; None where nothing is learned from it."""
        asked = self.queries[query]
        if asked.answer is None or asked.repeats is not None:
            return None
        return self._mu(asked.answer.response, weights or self.weights)

    def labels(self, weights=None):
        """[(number of the query, mu), ...] of all that preferences are learned from, in the order of answering."""
        labels = ((answer.query, self.mu(answer.query, weights)) for answer in self.answers)
        return [(query, mu) for query, mu in labels if mu is not None]

    @staticmethod
    def _mu(response, weights):
        """Table 1 and Eq. 2 of the paper, in single precision."""
        kind, said = _only(response)
        if kind == "skipped":
            return None
        if kind == "judged":
            _WORTHS[said]
            return None
        if kind == "preferred":
            return _weighted(1.0, said)
        if kind == "safety":
            if isinstance(said, dict):
                return _weighted(weights["default"], said["both"])
            return _weighted(weights["safety"], {"only_left": "left", "only_right": "right", "neither": "equal"}[said])
        if kind == "justified":
            places, preference = said
            listed = weights["justifications"]
            return _weighted(listed[min(_named(places), len(listed) - 1)][1], preference)
        raise ValueError(f"there is no response {kind!r}")

    def justification(self, answer):
        """The name of the justification of an answer that has one: the most severe of those that are active."""
        active = self.active(answer)
        return None if active is None else (active or [""])[0]

    def active(self, answer):
        """The names of all justifications that are active in an answer that has some, the most severe first."""
        kind, said = _only(answer.response)
        if kind != "justified":
            return None
        places = {said[0]} if isinstance(said[0], int) else set(said[0])
        return [name for place, (name, _) in enumerate(self.weights["justifications"]) if place in places]

    def verdicts(self):
        """The transitions that a verdict was given on, in the order of answering: a list of Judged."""
        judged = []
        for answer in self.answers:
            kind, said = _only(answer.response)
            transition = self.queries[answer.query].transition
            if kind == "judged" and transition is not None:
                judged.append(Judged(answer.query, transition, said, _WORTHS[said]))
        return judged

    def rows(self, weights=None):
        """The answers that count as dicts, in the columns that `dropj labels` writes."""
        return [self._row(self.queries[answer.query], answer, weights or self.weights) for answer in self.answers]

    def _row(self, query, answer, weights):
        kind, said = _only(answer.response)
        skipped = (said or "yes") if kind == "skipped" else None
        safe, preference = (None, None), None
        if kind == "safety":
            told = "both" if isinstance(said, dict) else said
            safe = (told in ("both", "only_left"), told in ("both", "only_right"))
            preference = said["both"] if told == "both" else None
        elif kind == "preferred":
            preference = said
        elif kind == "justified":
            preference = said[1]
        choice = query.choice
        if isinstance(choice, dict):
            name, of = _only(choice)
            choice = f"again {of}" if name == "again" else f"synthesized: {of}"
        mu = self.mu(query.number, weights)
        return {
            "query": query.number,
            "left_dream": query.left.dream,
            "left_start": query.left.start,
            "right_dream": query.right.dream,
            "right_start": query.right.start,
            "choice": choice,
            "protocol": _NAMES[answer.protocol],
            "skipped": skipped,
            "left_safe": safe[0],
            "right_safe": safe[1],
            "justification": self.justification(answer),
            "preference": preference,
            "mu": None if mu is None else float(mu),
            "secs": answer.secs,
            "loops": answer.loops,
            "annotator": answer.annotator,
            "sides_swapped": answer.sides_swapped,
            "left_unsafe_from": answer.left_unsafe_from,
            "right_unsafe_from": answer.right_unsafe_from,
            "at": answer.at,
            "step": query.transition.step if query.transition else None,
            "verdict": said if kind == "judged" else None,
            "active": None if self.active(answer) is None else "|".join(self.active(answer)),
        }

    # What was shown, as numbers.

    @property
    def world(self):
        """The world model that everything here was dreamed with."""
        if not isinstance(self._world, WorldModel):
            path = self._world if self._world is not None else self._found()
            self._world = load_world(path, backend=self._backend)
        if not self._is_checked and self._world.hash != self.header["world_model"]:
            warnings.warn(
                f"this session was dreamed with the world model {self.header['world_model']}, and this is {self._world.hash}: "
                f"another one, or the same stored anew: {self.folder}",
                stacklevel=3,
            )
        self._is_checked = True
        return self._world

    def _found(self):
        """The file of the world model, looked for by its hash where it may lie."""
        wanted, met = self.header["world_model"], set()
        for path in self._candidates():
            path = path.resolve()
            if path in met or not path.is_file() or path.stat().st_size > _MOST_BYTES:
                continue
            met.add(path)
            if _arrays.sha256(path) == wanted:
                return path
        raise FileNotFoundError(f"the world model {wanted} of this session is not found: give its path as world=: {self.folder}")

    def _candidates(self):
        folder, hint = self.folder.resolve(), self.header.get("world_model_path")
        yield folder / "world_model.safetensors"
        if hint:
            yield folder / hint
            yield folder.parent / PurePath(hint).name
        for place in (folder, folder.parent, Path("assets")):
            files = sorted(place.glob("*.safetensors"))
            yield from files[:_MANY]
        yield from sorted(folder.parent.glob("*/world_model.safetensors"))[:_MANY]

    def features(self, dream):
        """The features of every step of a dream: [T, Z + 2 M]."""
        return self._along(dream)[0]

    def _along(self, number):
        if number not in self._features:
            dream, world = self._of(self.dreams, number), self.world
            widths = [part.shape[-1] for part in dream.start] + [dream.zs.shape[1], dream.actions.shape[1]]
            z, m = world.n_latents, world.n_memory
            if widths != [z, m, m, z, world.n_actions]:
                raise ValueError(f"dream {number} was not dreamed with this world model: its states and actions are {widths}")
            self._features[number] = world.features_along(dream.start, dream.zs, dream.actions)
        return self._features[number]

    def segment(self, clip):
        """A clip as a Segment."""
        steps = slice(clip.start, clip.start + SEGMENT_LEN)
        return Segment(Clip(*clip), self.features(clip.dream)[steps], self.dreams[clip.dream].actions[steps])

    def frames(self, clip):
        """The pictures of a clip, as bytes: [20, H, W, 3]."""
        return self.world.decode(self.dreams[clip.dream].zs[clip.start : clip.start + SEGMENT_LEN])

    def pairs(self, weights=None, observation="features"):
        """All labels with their clips, as HumanCompatibleAI/imitation takes preferences: Pairs.

        observation is "features", "latents" or "picture". A fragment ends with what follows its last action: the dream's own
        next state, or, at the end of a dream, the one that the world model imagines in the mean.
        """
        labels = self.labels(weights)
        fragments = []
        for number, _ in labels:
            query = self.queries[number]
            fragments.append((self._fragment(query.left, observation), self._fragment(query.right, observation)))
        return Pairs(fragments, np.array([mu for _, mu in labels], np.float32), [number for number, _ in labels])

    def _fragment(self, clip, observation):
        features, last = self._along(clip.dream)
        rows = features[clip.start : clip.start + SEGMENT_LEN + 1]
        if len(rows) == SEGMENT_LEN:
            rows = np.concatenate([rows, last.features[None]])
        if observation == "latents":
            rows = rows[:, : self.world.n_latents]
        elif observation == "picture":
            rows = self.world.decode(rows[:, : self.world.n_latents])
        elif observation != "features":
            raise ValueError(f'observation is {observation!r}, and must be "features", "latents" or "picture"')
        actions = self.dreams[clip.dream].actions[clip.start : clip.start + SEGMENT_LEN]
        return Fragment(rows, actions, None, False)

    def reward_path(self):
        """The file of the reward that was learned last, or None."""
        return _inside(self.folder, self.fits[-1]["file"]) if self.fits else None

    def __repr__(self):
        return f"Session({os.fspath(self.folder)!r}, {len(self.dreams)} dreams, {len(self.answers)} answers)"


def _header(path):
    header = _json(path.read_bytes().decode("utf-8-sig"), path)
    if not isinstance(header, dict) or header.get("format") not in _FORMATS:
        raise ValueError(f"this is no session of the formats 1 to {_FORMATS[-1]}: {path}")
    missing = [name for name in ("protocol", "world_model", "config") if name not in header]
    if missing or "weights" not in header["config"]:
        raise ValueError(f"its {missing[0] if missing else 'config.weights'} is missing: {path}")
    return header


def _entries(path):
    """The lines of a log that are not blank, with their numbers. One that was cut short at the end has not happened."""
    lines = path.read_bytes().decode("utf-8-sig", "replace").split("\n")
    said = [(number, line) for number, line in enumerate(lines, 1) if line.strip()]
    for seq, (number, line) in enumerate(said):
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError) as error:
            if seq + 1 == len(said):
                return
            raise ValueError(f"line {number} is not JSON ({error}): {path}") from None
        if not isinstance(entry, dict) or entry.get("seq") != seq or "event" not in entry or "at" not in entry:
            raise ValueError(f"line {number} is not event {seq}: {path}")
        yield number, entry


def _json(text, path):
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"it is not JSON ({error}): {path}") from None


def _inside(folder, file):
    """The path of a file of the session, which must lie in its folder."""
    parts = PurePath(file)
    if parts.is_absolute() or ".." in parts.parts:
        raise ValueError(f"{file!r} does not lie in the session's folder: {folder}")
    return Path(folder) / parts


def _named(places):
    """The place of the justification that is named: the first of those that are active."""
    return places if isinstance(places, int) else min(places)


def _next(number, numbered):
    if number != len(numbered):
        raise ValueError(f"it has the number {number!r} where {len(numbered)} is next")


def _only(fields):
    """The key and the value of an object that has one."""
    if not isinstance(fields, dict) or len(fields) != 1:
        raise ValueError(f"{fields!r} is nothing that can be said")
    return next(iter(fields.items()))


def _weight(name, weight):
    if not 0.5 < weight <= 1:
        raise ValueError(f"the weight of {name!r} must be above 0.5 and at most 1, but is {weight}")
    return weight


def _weighted(weight, preference):
    """mu of a preference held with this weight."""
    weight = np.float32(weight)
    return {"left": weight, "equal": np.float32(0.5), "right": np.float32(1) - weight}[preference]
