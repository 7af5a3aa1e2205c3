"""Computes what tests/python.rs has computed in Rust, and says how far both are apart: python3 compare.py FOLDER."""

import csv
import json
import sys
import warnings
from pathlib import Path

import dropj
import numpy as np
from dropj import _arrays
from dropj._networks import torch_or_none

# How far the two may be apart: sums are taken in another order.
CLOSE = 5e-5


class Noise:
    """In place of a generator: the noise that Rust drew."""

    def __init__(self, uniform, normal):
        self.random, self.standard_normal = lambda _: uniform, lambda _: normal


def apart(found, wanted):
    found, wanted = np.asarray(found, np.float64), np.asarray(wanted, np.float64)
    if found.shape != wanted.shape:
        raise SystemExit(f"shapes differ: {found.shape} and {wanted.shape}")
    return float(np.abs(found - wanted).max()) if found.size else 0.0


def networks(folder, given, backend):
    """The name, the distance and the limit of all that a world model and a reward compute."""
    told, rust = _arrays.read(folder / "rust.safetensors")
    world = dropj.load_world(given["world"], backend=backend)
    state = dropj.State(rust["z"], rust["c"], rust["h"])
    yield "observe", apart(world.observe(rust["frames"].astype(np.uint8)), rust["observed"]), CLOSE
    for mode, tau in [("mean", 0.1), ("mean", 1.0), ("sample", 1.0), ("sample", 0.5)]:
        found = world.imagine(state, rust["actions"], tau, mode, Noise(rust["uniform"], rust["normal"]))
        yield f"imagine {mode} {tau}", apart(found.features, rust[f"{mode} {tau}"]), CLOSE
    c, h = world.remember(state, rust["actions"])
    yield "remember", apart(np.concatenate([c, h], -1), rust["remembered"]), CLOSE
    painted = world.decode(rust["z"]).astype(np.int64)
    # Rust paints in bf16 where the processor is quick at that.
    yield "decode (of 255)", apart(painted, rust["painted"]), 6 if told["kind"] == "BFloat16" else 1
    yield "decode in f32 (of 255)", apart(painted, rust["painted in f32"]), 1

    reward = dropj.load_reward(given["reward"], world=world, backend=backend)
    features, actions = rust["dream features"], rust["dream actions"]
    start = dropj.State(*(rust["dream start." + part] for part in "zch"))
    along, _ = world.features_along(start, rust["dream zs"], actions)
    yield "features of a dream", apart(along, features), CLOSE
    yield "reward", apart(reward.reward(features, actions), rust["reward"]), CLOSE
    yield "members", apart(reward.members(features, actions), rust["members"]), CLOSE
    yield "scaled actions", apart(reward.scaled(actions), rust["scaled"]), 1e-6
    with open(folder / "reward.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    yield "dropj reward --csv", apart(reward.reward(along, actions), [float(row["reward"]) for row in rows]), CLOSE
    columns = json.loads((folder / "reward.json").read_text())
    members = [columns[f"member_{i}"] for i in range(reward.n_members)]
    yield "dropj reward --json", apart(reward.members(along, actions), members), CLOSE

    for name in ("f16", "bf16"):
        narrow = dropj.load_world(folder / f"world-{name}.safetensors", backend=backend)
        yield f"observe {name}", apart(narrow.observe(rust["frames"].astype(np.uint8)), rust[f"observed {name}"]), CLOSE

    old = dropj.load_world(given["old world"], backend=backend)
    frames, z, actions = rust["old frames"].astype(np.uint8), rust["old z"], rust["old actions"]
    yield "observe, layout 1", apart(old.observe(frames), rust["old observed"]), CLOSE
    yield "decode, layout 1 (of 255)", apart(old.decode(z).astype(np.int64), rust["old painted"]), 2
    found = old.imagine(dropj.State(z, *old.no_memory(len(z))), actions)
    yield "imagine, layout 1", apart(found.features, rust["old imagined"]), CLOSE
    hazards = dropj.load_reward(given["hazards"], backend=backend)
    rows = (rust["dream features"], rust["dream actions"])
    yield "reward with hazards", apart(hazards.reward(*rows), rust["hazards"]), CLOSE
    yield "hazards", apart(hazards.hazards(*rows), rust["hazards shown"]), CLOSE
    for name in ("joint", "apart", "old sparse", "old reward"):
        reward = dropj.load_reward(given[name], backend=backend)
        features = rust["few features"] if "old" in name else rust["dream features"]
        actions = rust["few actions"] if "old" in name else rust["dream actions"]
        said = apart(reward.reward(features, actions), rust[name])
        yield f"reward of verdicts, {name}" if name != "old reward" else "reward, layout 1", said, CLOSE
        if name in ("joint", "apart"):
            yield f"chances, {name}", apart(reward.chances(features, actions), rust[f"{name} chances"]), CLOSE


def labels(folder, session, options, weights):
    """The rows that `dropj labels` wrote, and those that are read here."""
    session = dropj.read_session(session)
    rows = session.rows(session.weights_with(**weights))
    wanted = [json.loads(line) for line in (folder / options).read_text().splitlines()]
    if len(rows) != len(wanted):
        raise SystemExit(f"{options}: {len(rows)} rows, and {len(wanted)} are wanted")
    furthest = 0.0
    for found, row in zip(rows, wanted):
        for name in ("mu", "secs"):
            one, other = found.pop(name), row.pop(name)
            if (one is None) != (other is None):
                raise SystemExit(f"{options}, query {row['query']}: {name} is {one} and {other}")
            furthest = max(furthest, abs(one - other) if one is not None else 0)
        if found != row or list(found) != list(row):
            raise SystemExit(f"{options}: {found} is not {row}")
    return furthest


def main():
    folder = Path(sys.argv[1])
    given = json.loads((folder / "given.json").read_text())
    warnings.simplefilter("ignore")  # models that were stored anew
    backends = ["numpy"] + ["torch"] * (torch_or_none() is not None)
    found = [(f"{backend}: {name}", *rest) for backend in backends for name, *rest in networks(folder, given, backend)]
    for name, session, weights in given["labels"]:
        found.append((f"mu of {name}", labels(folder, session, name, weights), 1e-6))
    for name, distance, most in found:
        print(f"{name}: {distance:.3g} apart, at most {most:g}")
    too_far = [name for name, distance, most in found if not distance <= most]
    if too_far:
        raise SystemExit(f"too far apart: {', '.join(too_far)}")


main()
