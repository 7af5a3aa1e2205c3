"""A world for tests: a boat in a channel that bends. Python's standard library alone.

channel_world.py [FAULT [STEP]]: serves, or in that step dies, hangs, prints or sends rubbish.
"""

import json
import os
import random
import struct
import sys
import time

HEIGHT, WIDTH, LAST = 16, 24, 80
FAULT = sys.argv[1] if len(sys.argv) > 1 else ""
AT = int(sys.argv[2]) if len(sys.argv) > 2 else 20
OUT = os.dup(1)
os.dup2(2, 1)  # what anybody prints goes to standard error


def send(header, pixels=b""):
    text = json.dumps(header).encode()
    data = struct.pack("<II", len(text), len(pixels)) + text + pixels
    while data:
        data = data[os.write(OUT, data):]


class Channel:
    """The middle of the channel wanders; rudder from 0 (left) to 10 (right), neutral 5; throttle from 0 to 2."""

    def reset(self, seed):
        self.rng = random.Random(seed)
        self.t, self.boat, self.middle, self.bend, self.way = 0, 0.0, 0.0, 0.0, 0.0
        self.wanted = 0.0

    def step(self, rudder, throttle):
        self.t += 1
        if self.rng.random() < 0.1:
            self.bend = self.rng.uniform(-0.05, 0.05)
        self.middle = max(-0.6, min(0.6, self.middle + self.bend))
        self.boat = max(-1.0, min(1.0, self.boat + 0.03 * (rudder - 5)))
        self.way = 0.0 if self.aground() else throttle

    def aground(self):
        return abs(self.boat - self.middle) > 0.35

    def act(self):
        if self.rng.random() < 0.08:
            self.wanted = self.rng.choice([0.0, 0.0, self.rng.uniform(-0.8, 0.8)])
        off = self.middle + self.wanted - self.boat
        return [max(0.0, min(10.0, 5 + 12 * off)), self.rng.uniform(0.5, 2.0)]

    def picture(self):
        rows = bytearray()
        for y in range(HEIGHT):
            for x in range(WIDTH):
                at = (x + 0.5) / WIDTH * 2 - 1
                boat = abs(at - self.boat) < 0.09 and 6 <= y < 10
                land = abs(at - self.middle) > 0.35 + 0.08
                rows += bytes([250, 250, 80] if boat else [90, 60, 30] if land else [30, 60 + 4 * ((y + self.t) % 4), 200])
        return bytes(rows)

    def frame(self, n, asked, reward=None):
        known = {"aground": self.aground(), "way": self.way}
        return {
            "type": "frame", "n": n, "height": HEIGHT, "width": WIDTH, "reward": reward, "terminated": False,
            "truncated": self.t >= LAST, "fields": {name: known.get(name) for name in asked},
        }


def fault():
    if FAULT == "dies":
        sys.stderr.write("the hull has a leak\n")
        os._exit(3)
    if FAULT == "hangs":
        time.sleep(60)
    if FAULT == "prints":
        os.write(OUT, b"knot 7 of 12\n")
        time.sleep(60)
    if FAULT == "rubbish":
        os.write(OUT, bytes(range(256)) * 40)
    if FAULT == "raises":
        send({"type": "error", "message": "ValueError: no wind", "traceback": "Traceback: in the sails\n"})
        sys.exit(1)


def main():
    send({
        "type": "hello", "protocol": 1, "name": "channel", "image": {"height": HEIGHT, "width": WIDTH}, "hertz": 10, "policy": True,
        "axes": [{"name": "rudder", "low": 0, "high": 10, "neutral": 5}, {"name": "throttle", "low": 0, "high": 2, "neutral": 0}],
        "longest_episode": LAST, "events": [{"name": "aground", "kind": "safety", "field": "aground"}],
    })
    print("a channel, ready")
    channel, asked, steps = Channel(), [], 0
    while True:
        lengths = sys.stdin.buffer.read(8)
        if len(lengths) < 8:
            return
        n_header, _ = struct.unpack("<II", lengths)
        request = json.loads(sys.stdin.buffer.read(n_header))
        if request["type"] == "close":
            return
        if request["type"] == "reset":
            asked = request["fields"]
            channel.reset(request["seed"])
            send(channel.frame(request["n"], asked), channel.picture())
        elif request["type"] == "act":
            send({"type": "action", "n": request["n"], "action": channel.act()})
        else:
            steps += 1
            if steps == AT:
                fault()
            channel.step(*request["action"])
            send(channel.frame(request["n"], asked, channel.way), channel.picture())


main()
