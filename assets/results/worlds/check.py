"""Drives a served world as dropj would: python3 check.py FOLDER [--episodes N] [--steps N] [--csv FILE]

Says whether equal seeds and actions give equal pictures, and what the world's own policy does. Python 3.11's standard library alone.
"""

import argparse
import collections
import json
import os
import pathlib
import random
import statistics
import struct
import subprocess
import time
import tomllib


class Process:
    def __init__(self, folder, spec):
        environment = {**os.environ, **spec["source"].get("environment", {}), "DROPJ_PROTOCOL": "1", "PYTHONUNBUFFERED": "1"}
        environment.pop("SDL_VIDEODRIVER", None)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        self.child = subprocess.Popen(spec["source"]["command"], cwd=folder, env=environment, **pipes)
        self.n, (self.hello, _) = 0, self.receive()

    def receive(self):
        n_header, n_pixels = struct.unpack("<II", self.child.stdout.read(8))
        header, pixels = json.loads(self.child.stdout.read(n_header)), self.child.stdout.read(n_pixels)
        assert header["type"] != "error", header["traceback"]
        return header, pixels

    def ask(self, kind, **more):
        self.n += 1
        text = json.dumps({"type": kind, "n": self.n, **more}).encode()
        self.child.stdin.write(struct.pack("<II", len(text), 0) + text)
        self.child.stdin.flush()
        header, pixels = self.receive()
        assert header.pop("n") == self.n
        return header, pixels

    def close(self):
        self.child.stdin.close()
        self.child.wait(10)


def single(values):
    """Numbers as dropj keeps them, in single precision."""
    return list(struct.unpack(f"{len(values)}f", struct.pack(f"{len(values)}f", *values)))


def clipped(action, spec):
    return single([min(max(value, axis["low"]), axis["high"]) for value, axis in zip(action, spec["axes"])])


def random_pictures(process, spec, steps):
    """The pictures of one episode of random actions, each held for some steps."""
    rng, pictures = random.Random(7), [process.ask("reset", seed=3, fields=[])[1]]
    for step in range(steps):
        if step % 10 == 0:
            action = single([rng.uniform(axis["low"], axis["high"]) for axis in spec["axes"]])
        frame, pixels = process.ask("step", action=action)
        pictures.append(pixels)
        if frame["terminated"] or frame["truncated"]:
            break
    return pictures


def policy_episode(process, spec, seed, steps):
    """All frames' headers and pictures of an episode of the world's own policy, with the actions."""
    first, pixels = process.ask("reset", seed=seed, fields=["*"])
    taken = [(first, pixels, None)]
    while len(taken) <= steps and not (taken[-1][0]["terminated"] or taken[-1][0]["truncated"]):
        action = clipped(process.ask("act")[0]["action"], spec)
        taken.append((*process.ask("step", action=action), action))
    return taken


def events(spec, headers):
    """How many steps each event happened in."""
    counts, before = collections.Counter(), {}
    for i, header in enumerate(headers):
        for event in spec.get("events", []):
            value = header["fields"].get(event["field"])
            assert event.get("when", "true") == "true" and event.get("count", "per-step") != "of-passed", event
            begins = value and not (event.get("count") == "first-touch" and before.get(event["name"]))
            before[event["name"]] = value
            counts[event["name"]] += bool(begins and i > 0)
    return counts


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--steps", type=int, default=300, help="of an episode at the most")
    parser.add_argument("--csv", type=pathlib.Path, help="writes a line for each step of the policy: episode, step, action, fields")
    options = parser.parse_args()
    spec = tomllib.loads((options.folder / "world.toml").read_text())

    process, other = Process(options.folder, spec), Process(options.folder, spec)
    print(process.hello["name"], process.hello["versions"])
    one = random_pictures(process, spec, 100)
    random_pictures(process, spec, 5)  # and after an episode that was left
    assert one == random_pictures(process, spec, 100), "another episode of the same seed and actions has other pictures"
    assert one == random_pictures(other, spec, 100), "another process with the same seed and actions has other pictures"
    print(f"same seed, same actions: {len(one)} equal pictures, {len(set(one))} of them different")

    def told(seed):
        return policy_episode(other, spec, seed, 60)

    assert process.hello["policy"] and told(5) == told(5) and told(5) != told(6), "the seed does not decide what the policy does"
    other.close()

    began, n, total, kinds = time.monotonic(), 0, collections.Counter(), collections.Counter()
    rewards, fields, shares, rows = [], collections.defaultdict(list), collections.defaultdict(list), []
    for seed in range(options.episodes):
        taken = policy_episode(process, spec, seed, options.steps)
        headers, length = [header for header, _, _ in taken], len(taken) - 1
        n += length
        kinds["terminated" if headers[-1]["terminated"] else "truncated" if headers[-1]["truncated"] else "left"] += 1
        counts = events(spec, headers)
        total.update(counts)
        rewards.append(sum(header["reward"] or 0 for header in headers[1:]))
        for event in spec.get("events", []):
            shares[event["name"]].append(counts[event["name"]] / length)
        for step, (header, _, action) in enumerate(taken[1:]):
            for name, value in header["fields"].items():
                fields[name].append(value)
            rows.append([seed, step, *action, json.dumps(header["fields"])])
    seconds = time.monotonic() - began
    process.close()
    print(f"policy: {options.episodes} episodes, {n} steps, {n / seconds:.0f} a second; {dict(kinds)}")
    print(f"  reward an episode: {statistics.mean(rewards):.2f} ({min(rewards):.2f} to {max(rewards):.2f})")
    for event in spec.get("events", []):
        name, each = event["name"], sorted(shares[event["name"]])
        print(f"  {name}: {total[name]}, {100 * total[name] / n:.1f} % of steps; episodes {100 * each[0]:.0f} to {100 * each[-1]:.0f} %")
    if len(fields["speed"]) > 1:
        tenths = statistics.quantiles(fields["speed"], n=10)
        print(f"  speed: mean {statistics.mean(fields['speed']):.2f}, tenths {' '.join(f'{tenth:.1f}' for tenth in tenths)}")
    if options.csv:
        options.csv.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))


if __name__ == "__main__":
    main()
